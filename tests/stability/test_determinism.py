"""Same seed, same bits: from the simulated scene to the report, in any number of threads, in any process."""

import hashlib
import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import numba
import numpy as np
import pytest

from tests.patience import HANG_S
from tests.stability.benches import Scale
from tests.stability.cases import CASES
from tests.stability.judge import run

pytestmark = pytest.mark.slow

SMALL = Scale((40, 48), 40)
BY_TITLE = {case.title: case for case in CASES}
TITLES = [
    "channels: one behind a colour filter array",
    "fault: a step that multiplies means by 1e+06",
]
ROOT = Path(__file__).parents[2]


@lru_cache
def fingerprint(title, threads):
    """Hash every number that a case measures and recovers in so many threads."""
    before = numba.get_num_threads()
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    try:
        return hash_of_run(title)
    finally:
        numba.set_num_threads(before)


def hash_of_run(title):
    shot, result = run(BY_TITLE[title], SMALL)
    digest = hashlib.sha256()
    arrays = (shot.measurement, shot.masks, result.views, result.decode, result.depth, result.world_to_camera)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(repr((result.notes, result.verdict, [point.loss for point in result.curve])).encode())
    return digest.hexdigest()


@pytest.mark.parametrize("title", TITLES)
def test_a_case_has_the_same_bits_again_and_in_one_thread(title):
    assert fingerprint(title, 1) == fingerprint(title, 2)


def test_a_case_has_the_same_bits_in_another_process():
    script = "from tests.stability.test_determinism import hash_of_run, TITLES; print(hash_of_run(TITLES[0]))"
    paths = [str(ROOT / folder) for folder in (".", "drivers", "calibration", "sims")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "PYTHONHASHSEED": "7", "NUMBA_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=HANG_S, check=True, env=environment
    )
    assert done.stdout.strip() == fingerprint(TITLES[0], 2)

"""Options of the whole test suite, and how many threads each of its processes takes."""

import os
from pathlib import Path

import numba
import pytest
import torch

from gs2ci.evaluate.environment import machine


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--rig",
        type=Path,
        default=None,
        metavar="FILE",
        help="rig file of real devices on which tests/contracts/test_on_rig.py also runs; the stage moves by 1 mm",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Share the processors out among the processes of the suite: each would otherwise take all of them."""
    processes = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    threads = max(1, machine()["usable_cores"] // processes)
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    torch.set_num_threads(threads)

"""Captures killed at various moments: every row that was reported as taken is readable after `recover`.

A kill follows a number of reported shots, not a time, so that it happens during the capture on any machine.
"""

import os
import signal
import time
import traceback

import h5py
import numpy as np
import pytest

from gs2ci.core.errors import StorageError
from gs2ci.core.progress import Silent
from gs2ci.core.storage import recover
from gs2ci.rig.recording import prepare, record
from tests.nightly import but
from tests.patience import HANG_S

SHOTS = 10
LONGEST_S = 0.004  # a row takes about as long


class Telling(Silent):
    """A listener that reports each shot through a pipe, as a user would see it on the screen."""

    def __init__(self, pipe):
        super().__init__()
        self.pipe, self.where = pipe, ""

    def stage(self, name, total=None):
        self.where = name

    def step(self, done, **figures):
        if self.where == "shots":
            os.write(self.pipe, b".")


def capture_and_exit(small, out, pipe):
    """Be the child: capture until killed or done; never return to pytest."""
    try:
        devices = small.rig.open()
        record(small.rig, devices, prepare(small.rig, devices), out, replace=True, progress=Telling(pipe))
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        os._exit(1)


def killed_after(small, out, shots, delay_s):
    """Capture in a child, kill it `delay_s` after it opened its file and reported so many; return how many it had."""
    receiver, sender = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receiver)
        capture_and_exit(small, out, sender)
    os.close(sender)
    partial = out.with_name(out.name + ".partial")
    waiting_since = time.monotonic()
    while not (partial.exists() or out.exists()) and time.monotonic() - waiting_since < HANG_S:
        time.sleep(0.001)
    told = b""
    while len(told) < shots and (one := os.read(receiver, 1)):
        told += one
    time.sleep(delay_s)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    while chunk := os.read(receiver, 4096):
        told += chunk
    os.close(receiver)
    return len(told)


def rows_in(path):
    with h5py.File(path) as file:
        return file["meas"][:]


@pytest.mark.parametrize("kills", but(1, [12, 60]))
def test_every_row_that_was_reported_survives_kills(kills, make_small, tmp_path):
    changes = {"masks": 2, "mask_s": 0.01, "shots": SHOTS, "axis": ""}
    whole = rows_in(make_small(dlp5500=True, capture=changes).capture(tmp_path / "whole.h5"))
    rng = np.random.default_rng(5)
    interrupted = 0
    for kill in range(kills):
        out = tmp_path / f"{kill}.h5"
        shots, delay_s = int(rng.integers(SHOTS)), float(rng.uniform(0.0, LONGEST_S))
        reported = killed_after(make_small(dlp5500=True, capture=changes), out, shots, delay_s)
        partial = out.with_name(out.name + ".partial")
        if out.exists():
            saved = rows_in(out)
        else:
            try:
                saved = rows_in(recover(partial, tmp_path / f"{kill}.saved.h5"))
            except StorageError:  # killed before the first row: there is nothing to save, and nothing was reported
                saved = whole[:0]
            interrupted += len(saved) < SHOTS
        assert len(saved) >= reported
        differing = np.flatnonzero((saved != whole[: len(saved)]).any(axis=(1, 2)))
        assert not len(differing), f"kill {kill}: {reported} reported, {len(saved)} saved, rows {differing} differ"
    assert interrupted >= kills / 3, "the kills came too late to mean anything"

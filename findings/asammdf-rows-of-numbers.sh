#!/usr/bin/env bash
# A good guess: asammdf writes a signal whose samples are rows of numbers, such as a pose of four at each time, into an MDF file, or refuses it.
# Found: it takes them and saves them without an error; read from the file, the samples are the first numbers of the first row, one a time, and
# all others are gone. While the file is open they have the right shape and wrong values. Rows of bytes alone come back; pictures of bytes
# come as one row each.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check asammdf==8.8.28 numpy==2.4.6
v/bin/python -W error::UserWarning - <<'PY'
from importlib.metadata import version

import numpy as np
from asammdf import MDF, Signal


def saved(samples):
    """Return what the open file gives and what the saved one does."""
    measured = MDF()
    measured.append(Signal(samples, np.arange(len(samples), dtype=float), name="pose"))
    before = np.array(measured.get("pose").samples)
    measured.save("run.mf4", overwrite=True)
    with MDF("run.mf4") as read:
        return before, np.array(read.get("pose").samples)


poses = np.arange(12.0).reshape(3, 4)
for samples in (poses, poses.astype(np.float32), poses.astype(np.int16)):
    before, after = saved(samples)
    print("asammdf", version("asammdf"), samples.dtype, "open:", before.tolist(), "saved and read:", after)
    assert before.shape == poses.shape and not np.array_equal(before, poses), "the open file: the behaviour has changed"
    assert after.tolist() == [0, 1, 2], "the saved file: the behaviour has changed"
_, after = saved(poses.astype(np.uint8))
_, pictures = saved(poses.astype(np.uint8).reshape(3, 2, 2))
print("bytes:", after.tolist(), "pictures of 2 x 2 bytes:", pictures.shape)
assert np.array_equal(after, poses) and pictures.shape == (3, 4), "bytes: the behaviour has changed"
PY

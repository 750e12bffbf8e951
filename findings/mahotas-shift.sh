#!/usr/bin/env bash
# A good guess: mahotas' `interpolate.shift` moves a picture by what it is told, between pixels by splines of the order given (its default is 3), as
# SciPy's does. Found: it moves by a whole number of pixels whatever the order, one less than the shift rounded up: 0 moves the picture up and
# to the left by one, 0.5 and 1 not at all, 2.7 by two, -2.3 by minus three. Its `zoom` takes whole pixels of the picture too: a ramp zoomed
# threefold has steps of 0 and of 1, by each order, and a spot lies a pixel beside where SciPy's zoom puts it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check mahotas==1.4.19 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
import mahotas
import numpy as np
from mahotas import interpolate
from scipy import ndimage

rows, columns = np.mgrid[:60, :80]
spot = np.exp(-((columns - 35.0) ** 2 + (rows - 25.0) ** 2) / 12.5)


def moved(picture):
    """Return how far the spot's centroid lies from its place, in columns and rows."""
    return [round(float((picture * grid).sum() / picture.sum() - place), 2) for grid, place in ((columns, 35), (rows, 25))]


shifts = [0, 0.5, 1, 2.7, -2.3, 5]
found = {order: [moved(interpolate.shift(spot, (shift, shift), order=order)) for shift in shifts] for order in (0, 1, 3)}
scipy_moves = [moved(ndimage.shift(spot, (shift, shift), order=3)) for shift in shifts]
ramp = np.tile(np.arange(20.0), (20, 1))
steps = {order: sorted({round(float(step), 3) for step in np.diff(interpolate.zoom(ramp, 3, order=order)[30, :54])}) for order in (1, 3)}
zoomed = interpolate.zoom(spot, 3)
grids = np.mgrid[: zoomed.shape[0], : zoomed.shape[1]]
beside = [float((zoomed * grid).sum() / zoomed.sum()) for grid in grids[::-1]]
print("mahotas", mahotas.__version__, "shifts", shifts, "move by", found[3], "SciPy's by", scipy_moves)
print("steps of a ramp zoomed threefold", steps, "spot at 35, 25 zoomed to", np.round(beside, 2))
assert all(moves == [[np.ceil(shift) - 1] * 2 for shift in shifts] for moves in found.values()), "shifts: the behaviour has changed"
assert np.allclose(scipy_moves, np.array(shifts)[:, None], atol=0.02), "SciPy's: the behaviour has changed"
assert steps == {1: [0, 1], 3: [0, 1]}, "zoom: the behaviour has changed"
PY

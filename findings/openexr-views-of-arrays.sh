#!/usr/bin/env bash
# A good guess: OpenEXR's File writes a NumPy array's pixels as NumPy indexes them, or refuses an array that is a view
# with strides of its own, as it refuses float64.
# Found: it takes the memory row by row as if the array were contiguous, without a word. A depth map handed over as a
# transposed view comes out scrambled, of the right shape and type; a channel cut from an [H, W, C] image holds a mix of
# all channels. A copy (numpy.ascontiguousarray) is right. Upstream knows it for channels of an image (issue 1929).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet OpenEXR==3.5.3 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PY'
import numpy as np
import OpenEXR


def through_file(depth):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"Z": depth}) as file:
        file.write("depth.exr")
    with OpenEXR.File("depth.exr") as file:
        return file.channels()["Z"].pixels


columns_first = np.arange(6, dtype=np.float32).reshape(3, 2)
depth = columns_first.T
view, copy = through_file(depth), through_file(np.ascontiguousarray(depth))
print("OpenEXR", OpenEXR.__version__)
print("given", depth.tolist(), "read back", view.tolist(), "and of a copy", copy.tolist())
image = np.tile(np.array([10, 20, 30], np.float32), (2, 2, 1))
green = through_file(image[:, :, 1])
print("the channel of 20 in an image of 10, 20, 30:", green.tolist())
assert np.array_equal(copy, depth), "a contiguous array is no longer written as it is"
assert view.shape == depth.shape and view.tolist() == [[0, 1, 2], [3, 4, 5]], "the behaviour has changed"
assert green.tolist() == [[20, 30], [10, 20]], "the behaviour has changed"
PY

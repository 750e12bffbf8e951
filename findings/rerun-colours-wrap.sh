#!/usr/bin/env bash
# A good guess: Rerun cuts floating colours at 0 and 1, and takes pictures in any order of bytes. Found: colours above 1 wrap: of 1.5 a
# channel becomes 0.49, so that lights of splats and points are dark; half-precision colours are taken for packed numbers and become black;
# pictures of big-endian numbers, as FITS and PGM files have them, are logged byte by byte: 258 is read as 513. Nothing is said.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check rerun-sdk==0.41.0 numpy==2.4.6
v/bin/python -W error - <<'PY'
from importlib.metadata import version

import numpy as np
import rerun as rr


def logged(colours):
    splats = rr.GaussianSplats3D(centers=np.zeros((len(colours), 3)), scales=np.ones((len(colours), 3)), colors=colours)
    return [f"{packed:08x}" for packed in splats.colors.as_arrow_array().to_pylist()]


lit, halves = logged(np.array([[0.2, 0.5, 1.5]])), logged(np.array([[0.2, 0.5, 1.0]], np.float16))
picture = rr.Image(np.array([[258, 258]], ">u2"))
pixels = np.array(picture.buffer.as_arrow_array().to_pylist()[0], np.uint8).view("<u2").tolist()
datatype = picture.format.as_arrow_array().to_pylist()[0]["channel_datatype"]
plain = rr.Image(np.array([[258, 258]], "<u2")).format.as_arrow_array().to_pylist()[0]["channel_datatype"]
print("Rerun", version("rerun-sdk"), "0.2 0.5 1.5 becomes", lit, "in half precision", halves, "258 becomes", pixels)
assert lit == ["33807eff"] and halves != logged(np.array([[0.2, 0.5, 1.0]])), "the behaviour has changed"
assert pixels == [513, 513] and datatype == plain, "the behaviour has changed"
PY

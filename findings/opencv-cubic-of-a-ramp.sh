#!/usr/bin/env bash
# A good guess: cubic interpolation is better than linear, so at least what linear has exactly, a ramp, OpenCV's INTER_CUBIC has, too.
# Found: its kernel is the one with a = -0.75, which no ramp survives: a shift by a quarter of a pixel moves one by 0.297,
# 0.1 by 0.136, and an enlarged ramp has steps; what is measured between pixels is pulled to their halves by up to 0.047 px. INTER_LANCZOS4
# does so by a third of it. Pillow's bicubic (a = -0.5) and INTER_LINEAR are exact.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6 pillow==12.1.0
v/bin/python - <<'PY'
import cv2
import numpy as np
import PIL
from PIL import Image

ramp = np.tile(np.arange(64, dtype=np.float32), (64, 1))
kinds = {"linear": cv2.INTER_LINEAR, "cubic": cv2.INTER_CUBIC, "lanczos4": cv2.INTER_LANCZOS4}


def kernel(x, a):
    """Keys' cubic kernel."""
    x = abs(x)
    return (a + 2) * x**3 - (a + 3) * x**2 + 1 if x < 1 else a * (x**3 - 5 * x**2 + 8 * x - 4) if x < 2 else 0.0


def moved(shift, flags):
    picture = cv2.warpAffine(ramp, np.float32([[1, 0, shift], [0, 1, 0]]), (64, 64), flags=flags)
    return round(32 - float(picture[32, 32]), 3)


seen = {name: [moved(shift, flag) for shift in (0.1, 0.25, 0.5, 0.75)] for name, flag in kinds.items()}
place = ((np.arange(192) + 0.5) / 3 - 0.5)[60:132]
enlarged = {name: cv2.resize(ramp, (192, 64), interpolation=flag)[0, 60:132] for name, flag in kinds.items()}
enlarged["Pillow"] = np.asarray(Image.fromarray(ramp).resize((192, 64), Image.Resampling.BICUBIC))[0, 60:132]
errors = {name: round(float(abs(row - place).max()), 3) for name, row in enlarged.items()}
expected = [sum(k * kernel(k - shift, -0.75) for k in range(-1, 3)) for shift in (0.1, 0.25, 0.5, 0.75)]
print("opencv", cv2.__version__, "Pillow", PIL.__version__, "0.1, 0.25, 0.5 and 0.75 px move a ramp by", seen)
print("largest errors of a ramp three times as large", errors)
assert np.allclose(seen["cubic"], expected, atol=1e-3) and seen["cubic"][1] > 0.29, "cubic: the behaviour has changed"
assert seen["linear"] == [0.1, 0.25, 0.5, 0.75] and 0.255 < seen["lanczos4"][1] < 0.275, "the others: the behaviour has changed"
assert errors["cubic"] > 0.03 and errors["linear"] < 1e-3 and errors["Pillow"] < 1e-3, "enlarging: the behaviour has changed"
PY

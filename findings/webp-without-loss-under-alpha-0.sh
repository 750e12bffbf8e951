#!/usr/bin/env bash
# A picture written as lossless WebP by OpenCV (quality 101) or by Pillow (lossless=True) comes back with other colours where
# its alpha is 0. A good guess: lossless is lossless. In formats that keep numbers in such pictures (SOG keeps colours beside
# opacities) the numbers of what is transparent are lost; Pillow's `exact=True` keeps them, OpenCV has no such option.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT; cd "$place"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 opencv-contrib-python-headless==5.0.0.93 pillow==13.0.0
v/bin/python - <<'PY'
import io, sys
import cv2, numpy as np, PIL
from PIL import Image
print("opencv-contrib-python-headless", cv2.__version__, "and Pillow", PIL.__version__)
held = np.random.default_rng(0).integers(1, 255, (16, 16, 4), np.uint8)
held[:, ::2, 3] = 0
def changed(back):
    off = (back != held).any(axis=2)
    return int(off[:, ::2].sum()), int(off[:, 1::2].sum())
by_opencv = cv2.imdecode(cv2.imencode(".webp", held, [cv2.IMWRITE_WEBP_QUALITY, 101])[1], cv2.IMREAD_UNCHANGED)
def by_pillow(**options):
    file = io.BytesIO()
    Image.fromarray(held).save(file, "WEBP", lossless=True, **options)
    return np.array(Image.open(file).convert("RGBA"))
seen = {"OpenCV": changed(by_opencv), "Pillow": changed(by_pillow()), "Pillow, exact": changed(by_pillow(exact=True))}
for name, (clear, other) in seen.items():
    print(f"{name}: of 128 transparent pixels {clear} changed, of 128 others {other}")
sys.exit(not (seen["Pillow"][0] > 100 and seen["Pillow"][1] == 0 and seen["Pillow, exact"] == (0, 0)
              and seen["OpenCV"][0] > 100 and seen["OpenCV"][1] == 0))
PY

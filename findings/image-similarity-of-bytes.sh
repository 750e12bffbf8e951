#!/usr/bin/env bash
# A good guess: image-similarity-measures says of two 8-bit pictures what every other tool says: a spectral angle of 0 between a picture and
# itself, and the PSNR of a range of 255. Found: its command line and its functions multiply 8-bit samples in 8 bits, so that a grey picture of
# 200 lies 89.9 degrees from itself, and take 4095 as the brightest value unless told otherwise, which the command line cannot be: a PSNR is
# 24.1 dB too high (20 * log10(4095 / 255)), and SSIM is 0.97 for noise that scikit-image gives 0.13.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check image-similarity-measures==0.3.6 opencv-python==4.11.0.86 numpy==1.26.4 scikit-image==0.20.0 scipy==1.17.1
v/bin/python - <<'PY'
import cv2
import numpy as np

rng = np.random.default_rng(1)
truth = np.full((64, 64, 3), 200, np.uint8)
noisy = np.clip(200 + rng.normal(0, 20, truth.shape), 0, 255).astype(np.uint8)
cv2.imwrite("truth.png", truth)
cv2.imwrite("noisy.png", noisy)
PY
sam=$(v/bin/python -m image_similarity_measures.evaluate --org_img_path truth.png --pred_img_path truth.png --metric sam 2>/dev/null)
rest=$(v/bin/python -m image_similarity_measures.evaluate --org_img_path truth.png --pred_img_path noisy.png --metric psnr --metric ssim 2>/dev/null)
v/bin/python - "$sam" "$rest" <<'PY'
import json
import sys
from importlib.metadata import version

import cv2
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

angle = json.loads(sys.argv[1])["metrics"]["sam"]
found = json.loads(sys.argv[2])["metrics"]
truth, noisy = cv2.imread("truth.png"), cv2.imread("noisy.png")
psnr = peak_signal_noise_ratio(truth, noisy)
ssim = structural_similarity(truth, noisy, channel_axis=2)
print("image-similarity-measures", version("image-similarity-measures"), f"angle of a grey picture with itself: {angle:.1f} degrees")
print(f"PSNR {found['psnr']:.1f} dB, SSIM {found['ssim']:.4f}; scikit-image {psnr:.1f} dB, {ssim:.4f}")
assert angle > 80 and abs(found["psnr"] - psnr - 24.1) < 0.1 and found["ssim"] > 0.9 > ssim + 0.5, "the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: NVIDIA's FLIP either refuses 8-bit arrays or takes them for what they are, as its own reading of PNG files does. Found: they
# are accepted, converted as they stand and cut at 1, so that nearly all pixels are white in both: 0.05 for a change whose FLIP is 0.19, and an
# array of 8 bits of a file is much more alike than the file.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check flip-evaluator==1.7 numpy==2.4.6 pillow==12.0.0
v/bin/python - <<'PY'
from importlib.metadata import version

import flip_evaluator
import numpy as np
from PIL import Image

rng = np.random.default_rng(0)
truth = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
brighter = np.minimum(truth.astype(int) + 13, 255).astype(np.uint8)
Image.fromarray(truth).save("truth.png")
Image.fromarray(brighter).save("brighter.png")
files = flip_evaluator.evaluate("truth.png", "brighter.png", "LDR")[1]
floats = flip_evaluator.evaluate(truth.astype(np.float32) / 255, brighter.astype(np.float32) / 255, "LDR")[1]
counts = flip_evaluator.evaluate(truth, brighter, "LDR")[1]
print("flip-evaluator", version("flip-evaluator"), f"files {files:.3f}, floats {floats:.3f}, 8-bit arrays {counts:.3f}")
assert abs(files - floats) < 0.01 and counts < 0.3 * files, "the behaviour has changed"
PY

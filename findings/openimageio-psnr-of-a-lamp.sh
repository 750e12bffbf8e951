#!/usr/bin/env bash
# A good guess: OpenImageIO's compare() gives floating pictures a PSNR with the peak of 1 that display-referred pictures have. Found: the peak
# is the largest value of either picture as soon as one lies above 1: pictures that differ by 0.1 everywhere have 20 dB, and 46 dB after one
# pixel of both was set to 20; its RMS and mean error are hardly changed. Scenes with a lamp cannot be compared with others by it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check OpenImageIO==3.2.2.0 numpy==2.4.6
v/bin/python - <<'PY'
import numpy as np
import OpenImageIO as oiio


def psnr_db(one, other):
    return oiio.ImageBufAlgo.compare(oiio.ImageBuf(one), oiio.ImageBuf(other), 0.0, 0.0).PSNR


truth = np.full((64, 64, 1), 0.5, np.float32)
found = truth + np.float32(0.1)
without = psnr_db(truth, found)
truth[5, 7] = found[5, 7] = 20
lamp = psnr_db(truth, found)
print("OpenImageIO", oiio.VERSION_STRING, f"PSNR {without:.1f} dB, with a lamp of 20 in both {lamp:.1f} dB")
assert abs(without - 20) < 0.01 and abs(lamp - without - 20 * np.log10(20)) < 0.01, "the behaviour has changed"
PY

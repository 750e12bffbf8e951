#!/usr/bin/env bash
# A good guess: the three ways in which OpenCV's structured light reads sinusoidal fringes (FTP, PSP, FAPS: one enumeration of one class) give
# the same wrapped phase but for a constant, so that the better one may be taken for the faster one. Found: along the very fringes that
# the class generates, PSP's phase rises and the two others' falls: hills become hollows where the method is exchanged.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check opencv-contrib-python-headless==4.12.0.88 numpy==2.2.6
v/bin/python - <<'PY'
import cv2
import numpy as np

rise = {}
for method, name in enumerate(("FTP", "PSP", "FAPS")):
    chosen = cv2.structured_light_SinusoidalPattern_Params()
    chosen.width, chosen.height, chosen.nbrOfPeriods = 256, 64, 16
    chosen.setMarkers, chosen.horizontal, chosen.shiftValue = False, False, 2 * np.pi / 3
    chosen.methodId = method
    fringes = cv2.structured_light.SinusoidalPattern_create(chosen)
    _, pictures = fringes.generate()
    phase, _ = fringes.computePhaseMap(pictures)
    along = np.unwrap(phase[32, 16:-16].astype(float))
    rise[name] = float(np.polyfit(np.arange(along.size), along, 1)[0]) * 16 / (2 * np.pi)
    print("OpenCV contrib", cv2.__version__, f"{name}: {rise[name]:+.3f} turns a fringe, first picture", pictures[0][32, :16:4])
assert all(abs(turns - right) < 0.01 for turns, right in zip(rise.values(), (-1, 1, -1))), "the behaviour has changed"
PY

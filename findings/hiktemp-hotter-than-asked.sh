#!/usr/bin/env bash
# A good guess: hiktemp, which reads temperatures from Hikvision's thermal cameras, finds the hottest pixel between two temperatures, as its page says,
# "restricted to pixels inside the temperature band", and says so where there is none. Found: the band is wider by a twentieth of its width, less
# what fades to a hundredth: between 0 and 100 degrees the hottest has 103.9. Of a scene with nothing in the band it is the pixel (0, 0), of
# 20 degrees where 120 to 150 were asked for; and with one limit alone, that limit does not count.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps hiktemp==0.2.0 numpy==2.4.6 requests==2.32.5 urllib3==2.5.0 idna==3.10 certifi==2025.10.5 charset-normalizer==3.4.4
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from hiktemp import ThermalFrame

assert "pixels inside the temperature band" in ThermalFrame.hotspot.__doc__, "the behaviour has changed"
degrees = np.full((4, 5), 20, np.float32)
degrees[1, 2], degrees[2, 3], degrees[3, 4] = 95, 103.9, 300
frame = ThermalFrame(degrees, b"", {})
asked = {(0, 100): frame.hotspot(0, 100), (120, 150): frame.hotspot(120, 150), "up to 100": frame.hotspot(hi=100)}
found = {limits: (place, round(float(degrees[place]), 1)) for limits, place in asked.items()}
inside = int(np.isfinite(frame.masked(0, 100)).sum())
print("hiktemp", version("hiktemp"), "hottest pixels and their degrees:", found, "pixels between 0 and 100:", inside, "of which there are", int((degrees <= 100).sum()))
assert found == {(0, 100): ((2, 3), 103.9), (120, 150): ((0, 0), 20.0), "up to 100": ((3, 4), 300.0)}, "the behaviour has changed"
assert inside == 19 and int((degrees <= 100).sum()) == 18, "the behaviour has changed"
PY

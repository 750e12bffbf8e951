#!/usr/bin/env bash
# A good guess: pint reads "30 fps" as frames a second, "300 dpi" as dots an inch, "5 mil" as thousandths of an inch, and has no length for a camera's
# pixels. Found: 30 fps are feet a second, 9.144 m/s; 300 dpi are dry pints, 165 litres; 5 mil are an angle, 0.028 degrees; a
# pixel is CSS's, so 1000 px are 264.6 mm without a word of the camera. "DPI", "thou" and a unit of one's own are what one wants.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pint==0.25.3
v/bin/python - <<'PY'
from importlib.metadata import version

import pint

unit = pint.UnitRegistry()
print("pint", version("pint"))
read = {text: unit(text).to_base_units() for text in ("30 fps", "300 dpi", "5 mil", "1000 px")}
for text, quantity in read.items():
    print(text, "=", unit(text), "=", quantity)
assert read["30 fps"].check("[speed]") and round(read["30 fps"].magnitude, 6) == 9.144, "fps: the behaviour has changed"
assert read["300 dpi"].check("[volume]") and round(read["300 dpi"].magnitude, 3) == 0.165, "dpi: the behaviour has changed"
assert round(unit("5 mil").m_as("degree"), 4) == 0.0281, "mil: the behaviour has changed"
assert round(unit("1000 px").m_as("mm"), 2) == 264.58, "px: the behaviour has changed"
assert unit("300 DPI").check("1/[length]*[printing_unit]") and round(unit("1 thou").m_as("um"), 6) == 25.4, "others: the behaviour has changed"
PY

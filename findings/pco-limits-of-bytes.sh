#!/usr/bin/env bash
# A good guess: PCO's Python package makes bytes of 16-bit images between the limits that it is given once their automatic choice is switched
# off, and takes every NumPy array. Found: limits are set only while the automatic choice is on; off, 10000 and 40000 give the same bytes,
# those of the default of 20000. Bytes are sharpened unless asked otherwise, and of an array with steps (every second column) the memory
# between is converted.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pco==2.6.0 numpy==2.4.6
v/bin/python - <<'PY' 2> errors.txt || { cat errors.txt; exit 1; }
import ctypes
from importlib.metadata import version

import numpy as np
from pco.convert import Convert
from pco.loader import shared_library_loader

shared_library_loader.increment()
convert = Convert(ctypes.c_void_p(0), None, "bw", 16)  # without a camera
convert.do_auto_minmax = False
convert.create(16, 0, [1, 0, 0, 0, 1, 0, 0, 0, 1], 0)
sharpened = convert.convert_ctrl["sharpen"]


def of_bytes(image, max_limit):
    asked = {"sharpen": False, "adaptive_sharpen": False, "auto_minmax": False, "max_limit": max_limit}
    convert.set_control_properties({**convert.convert_ctrl, **asked})
    return sorted(set(convert.convert_16_to_8(image, convert.get_mode_flags(), 0, 0, 0).ravel().tolist()))


image = np.full((16, 32), 2000, np.uint16)
image[:, 1::2] = 10000
found = {limit: of_bytes(image, limit) for limit in (10000, 20000, 40000)}
stepped = of_bytes(image[:, ::2], 20000)
print("pco", version("pco"), "2000 and 10000 become", found, "sharpened by default", sharpened, "columns of 2000 alone", stepped)
assert found[10000] == found[20000] == found[40000] == [25, 127], "the behaviour has changed"
assert sharpened and stepped == [25, 127], "the behaviour has changed"
PY

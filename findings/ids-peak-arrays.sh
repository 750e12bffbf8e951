#!/usr/bin/env bash
# A good guess: an array that IDS's image library gives of an image, `get_numpy()`, is a copy, or keeps the image alive as NumPy's views do.
# Found: neither. The array owns no memory and has no base: who keeps the array alone holds numbers that the library may overwrite as
# soon as the image goes (`image.ConvertTo(...).get_numpy()` is enough); likewise an image made of an array does not keep the array.
# Copy, and hold both. Shown by counting references; nothing is read once its owner is gone.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check ids-peak-common==2.1.0 ids-peak-ipl==1.18.0 numpy==2.4.6
v/bin/python - <<'PY'
import sys
from importlib.metadata import version

import numpy as np
from ids_peak_ipl import ids_peak_ipl as ipl

memory = np.arange(64, dtype=np.uint8)
before = sys.getrefcount(memory)
image = ipl.Image.CreateFromSizeAndPythonBuffer(ipl.PixelFormatName_Mono8, memory, 8, 8)
of_memory = sys.getrefcount(memory) - before
memory[0] = 77
shared = int(image.get_numpy()[0, 0]) == 77
wide = image.ConvertTo(ipl.PixelFormatName_Mono16)
before = sys.getrefcount(wide)
array = wide.get_numpy()
of_image = sys.getrefcount(wide) - before
print("ids-peak-ipl", version("ids-peak-ipl"), "memory is shared:", shared, "references to the array:", of_memory, end=", ")
print("to the image:", of_image, "; the image's array owns its memory:", array.flags.owndata, "and has a base:", array.base is not None)
assert shared and of_memory == 0 == of_image and not array.flags.owndata and array.base is None, "the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: pillow-heif saves pictures without loss at quality -1, of which its page says "Set -1 for lossless quality". Found: of colour it halves the
# resolution: of noise of 8 bits pixels come back more than 150 levels off. With chroma=444 they are off by one, and only with
# matrix_coefficients=0 besides they come back. 16-bit pictures keep 10 bits, up to 63 levels off, and with the option for 12 bits
# up to 15. Grey of 8 bits has no loss.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pillow-heif==1.8.1 pillow==13.0.0
v/bin/python - <<'PY'
import io
import random
from importlib.metadata import version

import pillow_heif
from PIL import Image

print("pillow-heif", version("pillow-heif"), "libheif", pillow_heif.libheif_version())
draw = random.Random(0)


def off(mode, **options):
    """Return by how much pixels of noise that is saved at quality -1 are off at most."""
    pillow_heif.register_heif_opener(**{name: options.pop(name) for name in ("save_to_12bit",) if name in options})
    samples = draw.randbytes(64 * 64 * {"L": 1, "I;16": 2, "RGB": 3}[mode])
    file = io.BytesIO()
    Image.frombytes(mode, (64, 64), samples).save(file, "HEIF", quality=-1, **options)
    opened = Image.open(file)
    read = opened.tobytes()
    assert opened.mode == mode and len(read) == len(samples), "the behaviour has changed"
    kind = "H" if mode == "I;16" else "B"
    return max(abs(was - now) for was, now in zip(memoryview(samples).cast(kind), memoryview(read).cast(kind), strict=True))


colour = off("RGB"), off("RGB", chroma=444), off("RGB", chroma=444, matrix_coefficients=0)
grey = off("L"), off("I;16"), off("I;16", save_to_12bit=True)
print("levels off: colour of 8 bits", colour[0], "with chroma=444", colour[1], "and matrix_coefficients=0", colour[2], end=" ")
print("grey of 8 bits", grey[0], "of 16 bits", grey[1], "with the option for 12 bits", grey[2])
assert colour[0] > 150 and colour[1:] == (1, 0), "colour: the behaviour has changed"
assert grey == (0, 63, 15), "grey: the behaviour has changed"
PY

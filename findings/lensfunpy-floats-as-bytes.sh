#!/usr/bin/env bash
# A good guess: lensfunpy's apply_color_modification(), which takes arrays of bytes and of floats, corrects vignetting of whichever it gets. Found: it
# goes by initialize()'s pixel_format, which is bytes unless said. A picture of floats comes back with the left quarter of its rows off by any
# factor, since their bytes were corrected one by one, and the rest as it was; the answer is True. With pixel_format=np.float32 it is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check lensfunpy==1.18.0 numpy==2.4.6
cat > look.py <<'PY'
import lensfunpy
import numpy as np

WIDTH, HEIGHT = 600, 400
database = lensfunpy.Database()
camera = database.find_cameras("NIKON CORPORATION", "NIKON D3S")[0]
lens = database.find_lenses(camera, "Nikon", "Nikkor 28mm f/2.8D AF")[0]


def gains(kind, light, **told):
    modifier = lensfunpy.Modifier(lens, camera.crop_factor, WIDTH, HEIGHT)
    modifier.initialize(28.0, 2.8, 10.0, **told)
    picture = np.full((HEIGHT, WIDTH, 3), light, kind)
    assert modifier.apply_color_modification(picture) is True
    with np.errstate(all="ignore"):
        return picture[:, :, 0].astype(float) / light


found = {
    "bytes": gains(np.uint8, 60),
    "floats": gains(np.float32, 0.2),
    "floats, pixel_format=np.float32": gains(np.float32, 0.2, pixel_format=np.float32),
}
print("lensfunpy", lensfunpy.__version__, "gains in the upper left corner, the centre, the lower right corner")
for kind, gain in found.items():
    print(f"{kind:32}", *(f"{gain[y, x]:.4g}" for y, x in ((0, 0), (HEIGHT // 2, WIDTH // 2), (HEIGHT - 1, WIDTH - 1))))
right, wrong = found["floats, pixel_format=np.float32"], found["floats"]
assert np.allclose(found["bytes"], right, atol=0.02) and right[0, 0] > 2.5 and right[-1, -1] > 2.5
assert np.all(np.abs(wrong[:, WIDTH // 4 + 1 :] - 1) < 1e-6), "the behaviour has changed"
assert not 0.1 < wrong[0, 0] < 10, "the behaviour has changed"
PY
v/bin/python look.py

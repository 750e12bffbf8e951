#!/usr/bin/env bash
# A good guess: `principal_point_offset_x` of a camera of Mitsuba 3, "relative to the center of the film", is (cx - width / 2) / width: a
# positive one moves what lies ahead to the right, and `_y` moves it down. Found: both the other way: 0.1 of 64 px moves it 6.4 px to
# the left, 0.1 of 32 px 3.2 px up. A calibration carried over with its signs is off by twice its offset.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check mitsuba==3.9.1 drjit==1.5.0 numpy==2.4.6
v/bin/python - <<'PY'
import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")


def place_of_what_lies_ahead(**offsets):
    ahead = mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, 1], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 64, "height": 32, "rfilter": {"type": "box"}}
    sampler = {"type": "independent", "sample_count": 64}
    light = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    scene = {
        "type": "scene",
        "integrator": {"type": "path"},
        "sensor": {"type": "perspective", "fov": 60, "to_world": ahead, "film": film, "sampler": sampler, **offsets},
        "lamp": {"type": "sphere", "center": [0.0, 0.0, 10.0], "radius": 0.5, "emitter": light},
    }
    picture = np.array(mi.render(mi.load_dict(scene)))[..., 0]
    rows, columns = np.indices(picture.shape) + 0.5
    return float((picture * columns).sum() / picture.sum()), float((picture * rows).sum() / picture.sum())


middle = place_of_what_lies_ahead()
right = place_of_what_lies_ahead(principal_point_offset_x=0.1)[0] - middle[0]
down = place_of_what_lies_ahead(principal_point_offset_y=0.1)[1] - middle[1]
print("mitsuba", mi.__version__, "offsets of 0.1 move the picture by %.1f px along its columns and %.1f along its rows" % (right, down))
assert abs(right + 6.4) < 0.2 and abs(down + 3.2) < 0.2, "the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: Mitsuba's depth, by the integrator `depth` or as an AOV, which its page calls the distance from the pinhole, is that distance along the
# ray, whatever the near clip. Found: rays start at the near plane, and so does the distance: with a near clip of 1 a wall at 5 is at 4, and
# with the default of 0.01 all depths are a hundredth short, more at the corners, whereas the AOV `position` is right.
# A thin lens and an orthographic camera do the same.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check mitsuba==3.9.1 drjit==1.5.0 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
import mitsuba
import numpy as np

mitsuba.set_variant("scalar_rgb")
place = mitsuba.ScalarTransform4f
wall = {"type": "rectangle", "to_world": place().translate([0, 0, 5]).rotate([0, 1, 0], 180).scale(50)}
film = {"type": "hdrfilm", "width": 9, "height": 9, "rfilter": {"type": "box"}}


def depths(kind, near):
    """Return the depth in the middle and at a corner, by the integrator and as an AOV."""
    camera = {"type": kind, "far_clip": 100.0, "film": film, "sampler": {"type": "independent"}}
    camera["to_world"] = place().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, 1, 0])
    if near is not None:
        camera["near_clip"] = near
    camera |= {"perspective": {"fov": 60}, "thinlens": {"fov": 60, "aperture_radius": 1e-4, "focus_distance": 5.0}, "orthographic": {}}[kind]
    integrators = {"type": "depth"}, {"type": "aov", "aovs": "d:depth,p:position"}
    one, both = (np.array(mitsuba.render(mitsuba.load_dict({"type": "scene", "integrator": each, "sensor": camera, "wall": wall}), spp=64)) for each in integrators)
    assert np.allclose(both[..., -1], 5), "positions: the behaviour has changed"
    return np.array([float(picture[at]) for picture in (one[..., 0], both[..., -4]) for at in ((4, 4), (0, 0))])


found = {}
for kind in ("perspective", "thinlens", "orthographic"):
    # The same rays from as close to the pinhole as can be: what is left of them is the mean over a pixel.
    true = depths(kind, 1e-4)
    for near in (None, 1.0, 2.0):
        found[kind, near] = true - depths(kind, near)
        print("mitsuba", mitsuba.__version__, kind, f"near clip {near or 'not given'}: {true[:2].round(3).tolist()} in the middle and at a corner are short by {found[kind, near][:2].round(4).tolist()}; as an AOV by {found[kind, near][2:].round(4).tolist()}")
corner = np.sqrt(1 + 2 * (8 / 9 * np.tan(np.radians(30))) ** 2)
short = {}
for (kind, near), by in found.items():
    middle = 0.01 if near is None else near
    far = middle * (1 if kind == "orthographic" else corner)
    short[kind, near] = np.allclose(by, [middle, far, middle, far], rtol=0.02, atol=2e-4)
assert all(short.values()), "the behaviour has changed"
PY

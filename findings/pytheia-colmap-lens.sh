#!/usr/bin/env bash
# A good guess: PyTheia's WriteColmapFiles() hands a calibrated camera on as it is, or refuses it, as it does lenses that COLMAP lacks. Found: of a camera with k1 = -0.1 and k2 = 0.02
# COLMAP reads k1 twice, -0.1 and -0.1; and focal lengths of 500 and 510 px along the axes become one of 500. COLMAP sees points, which the observations beside them
# say were seen elsewhere, up to 6 px off. Places are written with six digits: those in a national grid move by metres.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pytheia==1.2.1 pycolmap==4.2.1 numpy==2.3.5
cat > look.py <<'PY'
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pycolmap
import pytheia
from pytheia import sfm

points = np.random.default_rng(0).uniform([-2, -1.5, 4], [2, 1.5, 6], (50, 3))


def write(folder, ratio, second, offset=0.0):
    """A scene of two views in COLMAP's files, and what the first view sees."""
    scene, seen = sfm.Reconstruction(), None
    for number in range(2):
        prior = sfm.CameraIntrinsicsPrior()
        prior.image_width, prior.image_height, prior.camera_intrinsics_model_type = 640, 480, "PINHOLE"
        stated = {"focal_length": [500.0], "aspect_ratio": [ratio], "principal_point": [330.0, 230.0], "radial_distortion": [-0.1, second, 0, 0]}
        for name, values in stated.items():
            getattr(prior, name).value = values
            getattr(prior, name).is_set = True
        view = scene.MutableView(scene.AddView(f"{number}.png", 0, float(number)))
        camera = view.MutableCamera()
        camera.SetFromCameraIntrinsicsPriors(prior)
        camera.SetPosition(np.array([0.3 * number + offset, 0, 0]))
        view.SetIsEstimated(True)
        places = [camera.ProjectPoint(np.r_[point + [offset, 0, 0], 1.0])[1] for point in points]
        seen = seen or places
        for place, point in zip(places, points):
            if number == 0:
                track = scene.MutableTrack(scene.AddTrack())
                track.SetPoint(np.r_[point + [offset, 0, 0], 1.0])
                track.SetIsEstimated(True)
        for track, place in zip(scene.TrackIds(), places):
            scene.AddObservation(number, track, sfm.Feature(place))
    Path(folder).mkdir()
    assert pytheia.io.WriteColmapFiles(scene, folder)
    return np.array(seen)


def by_colmap(folder):
    model = pycolmap.Reconstruction(folder)
    image = next(image for image in model.images.values() if image.name == "0.png")
    return model, model.cameras[image.camera_id], image


seen = write("lens", 1.02, 0.02)
model, camera, image = by_colmap("lens")
off = np.linalg.norm(camera.img_from_cam(image.cam_from_world() * points) - seen, axis=1)
print("pytheia", version("pytheia"), "f 500 and 510, k1 -0.1, k2 0.02 become", camera.model_name, camera.params.tolist(), "points are off by up to %.1f px" % off.max())
alike = write("alike", 1.0, -0.1)
model, camera, image = by_colmap("alike")
rest = np.linalg.norm(camera.img_from_cam(image.cam_from_world() * points) - alike, axis=1).max()
print("where both coefficients are -0.1 and both focal lengths 500: %.4f px" % rest)
write("grid", 1.0, -0.1, offset=2600000.0)
grid = np.array([point.xyz for point in by_colmap("grid")[0].points3D.values()])
print("x in a grid:", sorted(set(grid[:, 0].tolist())), "of", 2600000 + points[:, 0].min().round(2), "to", 2600000 + points[:, 0].max().round(2))
assert rest < 0.01
assert camera.model_name == "RADIAL" and off.max() > 3, "the lens: the behaviour has changed"
assert set(grid[:, 0]) == {2600000.0}, "the digits: the behaviour has changed"
PY
v/bin/python look.py 2> errors.txt || { cat errors.txt; exit 1; }

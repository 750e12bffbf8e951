#!/usr/bin/env bash
# A good guess: undistortEvents() of dv-processing, iniVation's library of event cameras, puts each event on the pixel that is nearest to undistort() of
# its place, and project() of a camera with a distortion projects a point through it. Found: places are cut to whole pixels, so that all events
# lie half a pixel to the upper left on average, and a lens without distortion moves six events of a thousand by a pixel; project() leaves
# the distortion out: a point that OpenCV projects to 593.1, 48.8 is at 620, 30. Points one by one are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check dv-processing==2.0.4 numpy==2.4.6 opencv-python-headless==5.0.0.93
v/bin/python - <<'PY'
from importlib.metadata import version

import cv2
import dv_processing as dv
import numpy as np

size, lens = (640, 480), [-0.2, 0.05, 0.001, -0.002]
model = dv.camera.DistortionModel.RADIAL_TANGENTIAL
curved, straight = (dv.camera.CameraGeometry(values, 500, 600, 320, 240, size, model) for values in (lens, [0, 0, 0, 0]))
places = np.random.default_rng(0).integers((100, 80), (540, 400), (2000, 2))
events = dv.EventStore()
for time, (x, y) in enumerate(places.tolist()):
    events.push_back(time, x, y, True)


def moved(camera):
    exact = np.array([camera.undistort((x, y)) for x, y in places.tolist()])
    return camera.undistortEvents(events).coordinates() - exact


matrix = np.array([[500, 0, 320], [0, 600, 240], [0, 0, 1.0]])
expected = cv2.undistortPoints(places[:, None].astype(float), matrix, np.array(lens), P=matrix)[:, 0]
exact = np.array([curved.undistort((x, y)) for x, y in places.tolist()])
off, none = moved(curved), moved(straight)
print("dv-processing", version("dv-processing"), "events minus undistort(): mean", off.mean(0).round(3), "largest", np.abs(off).max().round(3))
share = (np.abs(straight.undistortEvents(events).coordinates() - places) > 0).any(1).mean()
print("share of events that a lens without distortion moves:", share)
point = [0.6, -0.35, 1.0]
right = cv2.projectPoints(np.array([point]), np.zeros(3), np.zeros(3), matrix, np.array(lens))[0].ravel()
print("project:", curved.project(point), "OpenCV:", right.round(1))
assert np.abs(exact - expected).max() < 0.01
assert (np.abs(off.mean(0) + 0.5) < 0.02).all() and share > 0.001, "events: the behaviour has changed"
assert np.allclose(curved.project(point), (620, 30)) and np.abs(right - (593.13, 48.76)).max() < 0.1, "project: the behaviour has changed"
PY

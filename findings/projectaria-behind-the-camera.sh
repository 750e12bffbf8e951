#!/usr/bin/env bash
# A good guess: project() of Project Aria's tools, which says that it makes "a number of validity checks to ensure the point is visible" and answers
# None where one fails, does so for points behind the camera. Found: of its spherical and fisheye models; its linear one, which is what pictures are
# undistorted to, answers with the pixel at which the point mirrored through the camera's centre is seen. Only the plane of the camera
# itself and what falls outside the picture are None.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check projectaria-tools==2.3.0 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from projectaria_tools.core import calibration

linear = calibration.get_linear_camera_calibration(100, 50, 80.0, "linear")
spherical = calibration.get_spherical_camera_calibration(100, 50, 80.0, "spherical")
before, behind, beside = np.array([0.1, 0.05, 1.0]), np.array([0.1, 0.05, -1.0]), np.array([5.0, 0.0, 1.0])
for camera in (linear, spherical):
    print("projectaria-tools", version("projectaria-tools"), camera.get_label(), *(camera.project(point) for point in (before, behind, beside)))
assert spherical.project(before) is not None and spherical.project(behind) is None, "spherical: the behaviour has changed"
assert linear.project(beside) is None and np.allclose(linear.project(before), [57.5, 28.5]), "what is seen: the behaviour has changed"
assert linear.project(behind) is not None and np.allclose(linear.project(behind), [41.5, 20.5]), "linear: the behaviour has changed"
PY

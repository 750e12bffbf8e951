#!/usr/bin/env bash
# A good guess: librealsense's rs2_deproject_pixel_to_point undoes rs2_project_point_to_pixel for each of its distortion models, or refuses.
# Found: it does for Brown-Conrady, its inverse and Kannala-Brandt, but a pixel of the "modified Brown-Conrady" model is deprojected as if
# the lens had no distortion (here 11 mm beside the point at 1 m), and a point is projected by "f-theta" as if it had none; no error, no word.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pyrealsense2==2.59.1.11053 numpy==2.4.6
v/bin/python - <<'PY'
import numpy as np
import pyrealsense2 as rs

print("pyrealsense2", rs.__version__)
point_m = [0.4, 0.3, 1.0]
off_mm, moved_px = {}, {}
for model, coefficients in {
    "none": [0, 0, 0, 0, 0],
    "brown_conrady": [0.1, -0.05, 0.002, -0.001, 0.01],
    "inverse_brown_conrady": [0.1, -0.05, 0.002, -0.001, 0.01],
    "modified_brown_conrady": [0.1, -0.05, 0.002, -0.001, 0.01],
    "kannala_brandt4": [0.01, -0.02, 0.001, 0.0005, 0],
    "ftheta": [0.9, 0, 0, 0, 0],
}.items():
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = 640, 480, 600.0, 600.0, 320.0, 240.0
    lens.model, lens.coeffs = getattr(rs.distortion, model), coefficients
    pixel = rs.rs2_project_point_to_pixel(lens, point_m)
    back_m = rs.rs2_deproject_pixel_to_point(lens, pixel, 1.0)
    off_mm[model] = 1000 * float(np.linalg.norm(np.subtract(back_m, point_m)))
    moved_px[model] = float(np.linalg.norm(np.subtract(pixel, [560, 420])))
    print(f"{model}: projected {moved_px[model]:.1f} px beside the pinhole's, back {off_mm[model]:.2f} mm beside the point")
right = ("none", "brown_conrady", "inverse_brown_conrady", "kannala_brandt4")
assert all(off_mm[model] < 0.01 for model in right)
assert off_mm["modified_brown_conrady"] > 5 and moved_px["ftheta"] == 0 and off_mm["ftheta"] > 50, "the behaviour has changed"
PY

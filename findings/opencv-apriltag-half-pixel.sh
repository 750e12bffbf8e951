#!/usr/bin/env bash
# A good guess: what refines the corners of an ArUco marker changes how exact they are, not where pixels are counted from. Found: in OpenCV 5
# the refinement "AprilTag" counts pixels from their edges, all others, and corners of chessboards in the same picture, from their centres:
# a marker whose edges lie at 79.5 and 239.5 px has corners at 80 and 240. A camera calibrated with one and posed with the other is half a
# pixel off in both directions. Nor do the other refinements agree with each other: the marker is 159, 159.9 and 159 px wide in them.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6
v/bin/python - <<'PY'
import cv2
import numpy as np

markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
marker = cv2.aruco.generateImageMarker(markers, 0, 160)  # 8 x 8 modules of 20 px
picture = np.full((300, 320), 255, np.uint8)
picture[60:220, 80:240] = marker  # pixel 80 is the first black one: its left edge lies at 79.5
left, right = 79.5, 239.5
found = {}
for name in ("NONE", "SUBPIX", "CONTOUR", "APRILTAG"):
    how = cv2.aruco.DetectorParameters()
    how.cornerRefinementMethod = getattr(cv2.aruco, f"CORNER_REFINE_{name}")
    corners = cv2.aruco.ArucoDetector(markers, how).detectMarkers(picture)[0][0].reshape(4, 2)
    found[name] = corners[:, 0].min() - left, corners[:, 0].max() - right
    print("OpenCV", cv2.__version__, f"{name}: left and right edge are found {found[name][0]:+.2f} and {found[name][1]:+.2f} px off")
board = np.kron((np.indices((5, 6)).sum(0) % 2).astype(np.uint8) * 255, np.ones((40, 40), np.uint8))
board = cv2.copyMakeBorder(board, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
seen, corners = cv2.findChessboardCornersSB(board, (5, 4))
assert seen
inner = corners.reshape(-1, 2)[:, 0].min() - 79.5
print(f"findChessboardCornersSB: the first inner corner is found {inner:+.2f} px off")
assert abs(inner) < 0.05, "the behaviour has changed"
assert np.allclose(found["APRILTAG"], 0.5, atol=0.05), "the behaviour has changed"
assert np.allclose(found["SUBPIX"], (0.06, -0.06), atol=0.05), "the behaviour has changed"
assert np.allclose(found["NONE"], (0.5, -0.5), atol=0.05) and np.allclose(found["CONTOUR"], (0.5, -0.5), atol=0.05), "the behaviour has changed"
PY

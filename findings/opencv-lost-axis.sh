#!/usr/bin/env bash
# A good guess: OpenCV 5's Python functions return points in one form, as [N, 1, 2] like OpenCV 4's, or all as [N, 2]. Found: chessboard
# corners, refined corners, `findNonZero` and `HoughLinesP` lost the axis of one, and histograms theirs; corners to track, tracked points,
# contours, projected and undistorted points and `HoughLines` kept it. `corners[:, 0]`, in OpenCV 4 all points, is all columns in OpenCV 5,
# without an error.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
cat > look.py <<'PY'
import json

import cv2
import numpy as np

board = np.kron((np.indices((7, 8)).sum(0) % 2).astype(np.uint8) * 255, np.ones((30, 30), np.uint8))
board = cv2.copyMakeBorder(board, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
corners = cv2.findChessboardCorners(board, (7, 6))[1]
tracked = cv2.goodFeaturesToTrack(board, 10, 0.1, 5)
places = np.c_[np.mgrid[0:7, 0:6].T.reshape(-1, 2), np.zeros(42)].astype(np.float32)
matrix = np.array([[500.0, 0, 160], [0, 500, 140], [0, 0, 1]])
projected = cv2.projectPoints(places, np.zeros(3), np.array([0, 0, 10.0]), matrix, None)[0]
edges = cv2.Canny(board, 50, 150)
axes = {
    "findChessboardCorners": corners.ndim,
    "findChessboardCornersSB": cv2.findChessboardCornersSB(board, (7, 6))[1].ndim,
    "cornerSubPix": cv2.cornerSubPix(board, corners.copy(), (5, 5), (-1, -1), (3, 30, 0.01)).ndim,
    "findNonZero": cv2.findNonZero(board).ndim,
    "HoughLinesP": cv2.HoughLinesP(edges, 1, 0.01, 80).ndim,
    "calcHist": cv2.calcHist([board], [0], None, [4], [0, 256]).ndim,
    "goodFeaturesToTrack": tracked.ndim,
    "calcOpticalFlowPyrLK": cv2.calcOpticalFlowPyrLK(board, board, tracked, None)[0].ndim,
    "findContours": cv2.findContours(board, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)[0][0].ndim,
    "projectPoints": projected.ndim,
    "undistortPoints": cv2.undistortPoints(projected, matrix, None).ndim,
    "HoughLines": cv2.HoughLines(edges, 1, 0.01, 80).ndim,
}
print(json.dumps([cv2.__version__, axes, list(corners[:, 0].shape)]))
PY
python3 -m venv old; old/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==4.13.0.92 numpy==2.4.6
python3 -m venv new; new/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6
for version in old new; do $version/bin/python look.py > $version.json; done
python3 - <<'PY'
import json

(old, before, points), (new, now, columns) = (json.load(open(f"{version}.json")) for version in ("old", "new"))
lost = [name for name in before if now[name] < before[name]]
kept = [name for name in before if now[name] == before[name]]
print(f"from OpenCV {old} to {new} an axis is lost by", *lost, "and kept by", *kept)
print("corners[:, 0] of 42 corners has the shape", points, "and then", columns)
assert lost == ["findChessboardCorners", "findChessboardCornersSB", "cornerSubPix", "findNonZero", "HoughLinesP", "calcHist"]
assert len(kept) == 6 and all(now[name] == 3 for name in kept), "the behaviour has changed"
assert (points, columns) == ([42, 2], [42]), "the behaviour has changed"
PY

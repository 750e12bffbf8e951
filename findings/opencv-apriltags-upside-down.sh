#!/usr/bin/env bash
# A good guess: an AprilTag that OpenCV draws (generateImageMarker with DICT_APRILTAG_36h11, 25h9 or 16h5) is the one that AprilTag draws,
# and its upper side is up for both libraries. Found: each is turned by 180 degrees. AprilTag's detector gives a tag of OpenCV that
# hangs upright a rotation of 180 degrees about its normal, OpenCV takes the lower right corner of a tag of AprilTag for the upper left
# one; poses and boards of several tags by one library do not fit what was printed by the other. The numbers agree.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 pyapriltags==3.4.3.1 numpy==2.4.6 colorama==0.4.6
v/bin/pip install --quiet --disable-pip-version-check --no-deps moms-apriltag==2023.1.15
v/bin/python - <<'PY'
import cv2
import numpy as np
from moms_apriltag import TagGenerator2
from pyapriltags import Detector

families = {"tag36h11": cv2.aruco.DICT_APRILTAG_36h11, "tag25h9": cv2.aruco.DICT_APRILTAG_25h9, "tag16h5": cv2.aruco.DICT_APRILTAG_16h5}
turned = {}
for family, name in families.items():
    pairs = [(TagGenerator2(family).generate(i), cv2.aruco.getPredefinedDictionary(name), i) for i in (0, 5, 11)]
    drawn = [(theirs > 127, cv2.aruco.generateImageMarker(ours, i, len(theirs)) > 127) for theirs, ours, i in pairs]
    turned[family] = {k for k in range(4) if all(np.array_equal(np.rot90(ours, k), theirs) for theirs, ours in drawn)}

dictionary = cv2.aruco.getPredefinedDictionary(families["tag36h11"])
seen = {}
for by, tag in (("OpenCV", cv2.aruco.generateImageMarker(dictionary, 5, 8)), ("AprilTag", TagGenerator2("tag36h11").generate(5))):
    picture = np.full((240, 320), 255, np.uint8)
    picture[60:140, 100:180] = np.kron(tag, np.ones((10, 10), np.uint8))
    pose = {"estimate_tag_pose": True, "camera_params": (500, 500, 160, 120), "tag_size": 0.1}
    found = Detector(families="tag36h11").detect(picture, **pose)[0]
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(picture)
    first = np.reshape(corners[0], (4, 2))[0].round().astype(int).tolist()
    seen[by] = found.tag_id, int(np.ravel(numbers)[0]), found.pose_R.diagonal().round(2).tolist(), first
    print("opencv", cv2.__version__, "tag drawn by", by, "numbers", seen[by][:2], "AprilTag's rotation", seen[by][2], "OpenCV's first corner", first)
print("quarter turns from OpenCV's drawing to AprilTag's", turned)
assert all(turns == {2} for turns in turned.values()), "drawings: the behaviour has changed"
assert all(numbers[:2] == (5, 5) for numbers in seen.values()), "numbers: the behaviour has changed"
assert seen["OpenCV"][2] == [-1, -1, 1] and seen["AprilTag"][2] == [1, 1, 1], "poses: the behaviour has changed"
assert max(seen["OpenCV"][3]) <= 101 and min(seen["AprilTag"][3]) >= 138, "corners: the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: rosbags-image skips what pads the rows of a ROS image, whose message tells the length of a row (step) beside the width.
# Found: it does not read it: of a camera that pads rows to 4 bytes each row begins with the last one's padding, and the lowest rows are lost;
# and mono8 asked as mono16 is an array of doubles.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check rosbags==0.11.9 rosbags-image==0.10.4 opencv-python-headless==5.0.0.93 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from rosbags.image import message_to_cvimage
from rosbags.typesys import Stores, get_typestore

types = get_typestore(Stores.ROS2_HUMBLE).types
stamp = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")
rows = np.full((3, 4), 255, np.uint8)
rows[:, :3] = [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
image = types["sensor_msgs/msg/Image"](stamp, 3, 3, "mono8", 0, 4, rows.ravel())
read = message_to_cvimage(image)
doubled = message_to_cvimage(types["sensor_msgs/msg/Image"](stamp, 3, 4, "mono8", 0, 4, rows.ravel()), "mono16")
print("rosbags-image", version("rosbags-image"), read.tolist(), "instead of", rows[:, :3].tolist(), "mono16 is", doubled.dtype)
assert read.tolist() == [[1, 2, 3], [255, 4, 5], [6, 255, 7]] and doubled.dtype == np.float64, "the behaviour has changed"
PY

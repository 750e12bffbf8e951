#!/usr/bin/env bash
# A good guess: Timecode("24", start_seconds=1) of the package timecode is 00:00:01:00, Timecode("29.97", start_seconds=3600) is an hour, and at
# 12.5 frames a second ("any integer or fractional value is accepted") 00:00:10:00 is frame number 125. Found: the first is 00:00:00:23, and so on: a
# frame early at each rate, since seconds are counted as frames from 1; the second is 01:00:03;17, 3.6 s late; the third is 120,
# the rate being cut to 12.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check timecode==1.5.1
v/bin/python - <<'PY'
from importlib.metadata import version

from timecode import Timecode

print("timecode", version("timecode"))
for rate in ("24", "25", "50"):
    begin = Timecode(rate, start_seconds=1)
    print(f"{rate}: start_seconds=1 is {begin}, frame number {begin.frame_number}; 00:00:01:00 is {Timecode(rate, '00:00:01:00').frame_number}")
    assert begin.frame_number == int(rate) - 1, "the behaviour has changed"
    assert Timecode(rate, "00:00:01:00").frame_number == int(rate)
hour = Timecode("29.97", start_seconds=3600)
print("29.97: start_seconds=3600 is", hour, "of real time", round(hour.to_realtime(True), 3), "; 01:00:00;00 is", round(Timecode("29.97", "01:00:00;00").to_realtime(True), 3))
assert str(hour) == "01:00:03;17", "an hour: the behaviour has changed"
slow = Timecode("12.5", "00:00:10:00")
print("12.5: 00:00:10:00 is frame number", slow.frame_number, "where 10 s have 125")
assert slow.frame_number == 120, "12.5: the behaviour has changed"
PY

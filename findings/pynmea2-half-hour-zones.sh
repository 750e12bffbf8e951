#!/usr/bin/env bash
# A good guess: pynmea2 reads the local zone of a ZDA sentence, -03 hours and 30 minutes, as three and a half hours: NMEA's minutes have the sign of the
# hours. Found: the minutes are added to the negative hours: the zone is -2:30, and localdatetime an hour off. +05 and 30 is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pynmea2==1.19.0
v/bin/python - <<'PY'
import datetime
from importlib.metadata import version

import pynmea2

hours = {}
for zone in ("05,30", "-03,30", "-09,30"):
    read = pynmea2.parse(f"$GPZDA,120000.00,16,09,2002,{zone}")
    hours[zone] = read.localdatetime.utcoffset() / datetime.timedelta(hours=1)
    print("pynmea2", version("pynmea2"), zone, "is", hours[zone], "hours;", read.datetime.time(), "is", read.localdatetime.time())
assert hours["05,30"] == 5.5
assert (hours["-03,30"], hours["-09,30"]) == (-2.5, -8.5), "the behaviour has changed"
PY

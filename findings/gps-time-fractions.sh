#!/usr/bin/env bash
# A good guess: the Aerospace Corporation's gps-time reads a time stamp with milliseconds and an offset from UTC, as cameras' and computers' clocks write
# them and as Python's own datetime does, or refuses it. Found: cast_to_datetime() drops every fraction that is not of six digits: 250 ms are
# 0, and an exposure and its trigger fall together; and it calls each time UTC, whatever offset stands behind it, two hours off.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps gps-time==3.0.0 numpy==2.4.6 ruamel.yaml==0.18.16
v/bin/python - <<'PY'
from datetime import datetime
from importlib.metadata import version

from gps_time import GPSTime
from gps_time.datetime import cast_to_datetime

found = {}
for stamp in ("2026-11-30T17:00:00.250000", "2026-11-30T17:00:00.250", "2026-11-30T17:00:00.25", "2026-11-30T17:00:00.250000+02:00"):
    time = cast_to_datetime(stamp)
    seconds = GPSTime.from_datetime(time).time_of_week
    true = datetime.fromisoformat(stamp if "+" in stamp else stamp + "+00:00")
    found[stamp[19:]] = (time - true).total_seconds()
    print("gps-time", version("gps-time"), stamp, "is", time.isoformat(), f"second {seconds} of the week, off by {found[stamp[19:]]} s")
assert found == {".250000": 0, ".250": -0.25, ".25": -0.25, ".250000+02:00": 7200}, "the behaviour has changed"
try:
    cast_to_datetime("30 November 2026")
    raise SystemExit("the behaviour has changed")
except OSError:
    pass
PY

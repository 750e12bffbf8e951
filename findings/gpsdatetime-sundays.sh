#!/usr/bin/env bash
# A good guess: gpsdatetime makes a time of a GPS week, a day and an hour for each of the seven days, and of the 0 of each of its scales, and leaves the rest
# of the program alone. Found: on day 0, Sunday, the hour is dropped: noon is midnight. A week, a Unix time or a Julian date of 0 is this moment, as
# if nothing had been given. And a time made of a date sets the variable TZ to GMT: whatever program is started from then on, a camera's
# recorder or `date`, has other local times, by 9 hours in Tokyo, as has this one when it reads the variable.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps gpsdatetime==1.0.32
TZ=JST-9 v/bin/python -W ignore - <<'PY'
import subprocess
import time
from importlib.metadata import version

from gpsdatetime import gpsdatetime


def started():
    """Return the local hour of the Unix time 0 in a program that is started now."""
    return int(subprocess.run(["date", "-d", "@0", "+%H"], capture_output=True, check=True, text=True).stdout)


before, hours = started(), {}
for day in range(7):
    made = gpsdatetime(wk=2300, wd=day, h=12)
    hours[made.wd_en] = made.hh
zeros = {name: gpsdatetime(**{name: 0}).yyyy for name in ("wk", "timestamp", "jd50", "mjd")}
between = started()
gpsdatetime(yyyy=2024, mon=6, dd=2, h=12)
after = started()
time.tzset()
print("gpsdatetime", version("gpsdatetime"), "hours of noons of week 2300:", hours, "; years of 0:", zeros, "; the local hour of the Unix time 0 in programs started before:", before, ", after times of weeks:", between, ", after a time of a date:", after, "; here, once it is read:", time.localtime(0).tm_hour)
assert before == between == 9 and all(hours[day] == 12 for day in hours if day != "SUN")
assert hours["SUN"] == 0, "Sundays: the behaviour has changed"
assert all(abs(year - time.gmtime().tm_year) <= 1 for year in zeros.values()), "zeros: the behaviour has changed"
assert after == 0 and time.localtime(0).tm_hour == 0, "the time zone: the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: the command gnsstimecalc of gnsstoolbox-timecalc gives the GPS week and second of a time that is told as a date, or as seconds or milliseconds
# since 1970. Found: seconds, by --epoch_sec, are read and not used: whatever they are, the week and second of now come out; milliseconds
# are a TypeError, and so is the first second of 2017, with which the last span of its table of leap seconds begins.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check gnsstoolbox-timecalc==0.1.2
v/bin/python - <<'PY'
import re
import subprocess
import sys
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path


def week(*told):
    """Return the week and second that gnsstimecalc tells, or the last line of what it says."""
    done = subprocess.run([Path(sys.executable).with_name("gnsstimecalc"), *told], capture_output=True, text=True, check=False)
    found = re.search(r"GPS WEEK: (\d+), TOW: ([\d.]+)", done.stderr)
    return (int(found[1]), float(found[2])) if found else done.stderr.strip().splitlines()[-1].split(":")[0]


AT = 1_700_000_000  # 14 November 2023, 22:13:20 UTC
right = week("--datetime", "2023-11-14 22:13:20")
before = (datetime.now(timezone.utc).timestamp() - 315_964_800 + 18) // 604_800
seconds = week("--epoch_sec", str(AT))
print("gnsstoolbox-timecalc", version("gnsstoolbox-timecalc"), f"of second {AT} as a date: {right}, as seconds: {seconds}", end=" ")
milliseconds, leap = week("--epoch", str(1000 * AT)), week("--datetime", "2017-01-01 00:00:00")
print(f"as milliseconds: {milliseconds}; of the first second of 2017: {leap}")
assert right == (2288, 252818.0)
assert seconds[0] >= before > right[0], "seconds: the behaviour has changed"
assert milliseconds == leap == "TypeError", "refusals: the behaviour has changed"
PY

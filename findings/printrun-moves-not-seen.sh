#!/usr/bin/env bash
# A good guess: Printrun's gcoder, which follows and estimates G-code for its senders, takes G01 for G1, homes what G28 X0 Y0 names, reads each
# of two commands in a line, and takes as long for ten ways of 10 mm in relative as in absolute coordinates. Found: G01 X5 is no move and ends at 0;
# G28 X0 Y0 sets the height of 5 mm to 0, too; of "G90 G1 X5" the move is lost; ten relative ways of a second take one second in all, since
# each is taken for a place; and half a circle by G2 takes no time and no width.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps Printrun==2.2.0
v/bin/python - <<'PY'
from importlib.metadata import version

from printrun.gcoder import GCode


def run(*lines):
    code = GCode(list(lines))
    where = tuple(round(value, 6) for value in code.abs_pos)
    print("Printrun", version("Printrun"), "; ".join(lines), "ends at", where, "takes", code.duration.total_seconds(), "s, y", code.ymin, code.ymax)
    return where, code.duration.total_seconds(), code.ymax - code.ymin


assert run("G90", "G1 X5 F600")[0] == (5, 0, 0)
assert run("G90", "G01 X5 F600")[0] == (0, 0, 0), "G01: the behaviour has changed"
assert run("G90 G1 X5 F600")[0] == (0, 0, 0), "two commands: the behaviour has changed"
assert run("G90", "G1 X10 Y10 Z5 F600", "G28 X0 Y0")[0] == (0, 0, 0), "G28: the behaviour has changed"
assert run("G90", *(f"G1 X{10 * step} F600" for step in range(1, 11)))[:2] == ((100, 0, 0), 10)
assert run("G91", *["G1 X10 F600"] * 10)[:2] == ((100, 0, 0), 1), "relative ways: the behaviour has changed"
assert run("G90", "G1 X0 Y0 F600", "G2 X20 Y0 I10 J0")[1:] == (0, 0), "arcs: the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: gcode-machine, which splits long lines of G-code into short ones for feed overrides, keeps where a path ends, and rapid moves whole.
# Found: parts of relative moves are each rounded to a thousandth: 100 mm in parts of 0.3 mm end at 99.9, while its own position says 100.
# And G21, millimetres, sets its kind of motion to G1, for it looks at the last digit, and G20 to G0: after "G0 X0" and "G21" the
# rapid move X2 is sent as slow parts; after "G1 X0" and "G20" it takes the slow move X2 for a rapid one.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check gcode-machine==1.0.3
v/bin/python - <<'PY'
import re
from importlib.metadata import version

from gcode_machine import GcodeMachine


def split(*lines, part=0.5):
    """Return the machine after the lines, and what it makes of them, less its comments."""
    machine, made = GcodeMachine(), []
    machine.do_fractionize_lines, machine.fract_linear_segment_len = True, part
    for line in lines:
        machine.set_line(line)
        machine.strip()
        machine.tidy()
        machine.parse_state()
        made += machine.fractionize()
        machine.done()
    return machine, [line for line in made if not line.startswith(";")]


def sum_of_parts(lines):
    return sum(float(length) for length in re.findall(r"X([\d.]+)", " ".join(lines)))


relative, parts = split("G91", "G1X100F600", part=0.3)
_, absolute = split("G90", "G1X100F600", part=0.3)
_, rapid = split("G0X0", "X2")
_, rapid_after_units = split("G0X0", "G21", "X2")
inches, slow_after_units = split("G1X0F100", "G20", "X2")
print("gcode-machine", version("gcode-machine"), "100 mm, relative:", round(sum_of_parts(parts), 6), "it says", relative.pos_w[0])
print("a rapid move", rapid, "after G21", rapid_after_units, "a slow one after G20", slow_after_units)
assert relative.pos_w[0] == 100 and absolute[-1] == "X100", "the behaviour has changed"
assert round(sum_of_parts(parts), 6) == 99.9, "relative moves: the behaviour has changed"
assert rapid == ["G00X0", "X2"], "rapid moves: the behaviour has changed"
assert rapid_after_units == ["G00X0", "G21", "G1X0.5", "X1", "X1.5", "X2"], "G21: the behaviour has changed"
assert slow_after_units[-1] == "X2" and inches.current_motion_mode == 0, "G20: the behaviour has changed"
PY

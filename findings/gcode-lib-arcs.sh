#!/usr/bin/env bash
# A good guess: gcode-lib's linearize_arcs makes short straight moves of all arcs in G-code, as its page says, by their centre (I, J) or by their
# radius (R), in the plane that G17 to G19 chose; it says that it cannot do helices. Found: an arc by its radius turns about its own beginning,
# and first jumps aside: a quarter of a circle of 10 mm goes by a point 14.1 mm off. In the plane of x and z, G18, the arc is
# drawn in x and y, with all of z in the first part. Neither is refused.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check gcode-lib==1.1.13
v/bin/python - <<'PY'
import math
from importlib.metadata import version

import gcode_lib


def places(text):
    """Return the places that the straight moves come by, from the second move on."""
    place, come_by = {"X": 0.0, "Y": 0.0, "Z": 0.0}, []
    for line in gcode_lib.linearize_arcs(gcode_lib.parse_lines(text)):
        assert not line.is_arc
        if line.is_move:
            place = {axis: line.words.get(axis, place[axis]) for axis in "XYZ"}
            come_by.append(tuple(place.values()))
    return come_by[1:]


def farthest_from_the_circle(points):
    return max(abs(math.hypot(x, y) - 10) for x, y, _ in points)


by_centre = places("G90\nG17\nG1 X10 Y0 Z0\nG3 X0 Y10 I-10 J0")
by_radius = places("G90\nG17\nG1 X10 Y0 Z0\nG3 X0 Y10 R10")
upright = places("G90\nG18\nG1 X10 Y0 Z0\nG2 X0 Z10 I-10 K0")
print("gcode-lib", version("gcode-lib"), "off the circle by centre:", round(farthest_from_the_circle(by_centre), 3), "mm")
print("by radius:", round(farthest_from_the_circle(by_radius), 3), "mm, the first move to", by_radius[0])
print("in x and z: y goes to", max(abs(y) for _, y, _ in upright), "z in the first move to", upright[0][2])
assert farthest_from_the_circle(by_centre) < 0.001, "by centre: the behaviour has changed"
assert math.isclose(by_radius[0][0], 24.141, abs_tol=0.001), "by radius: the behaviour has changed"
assert max(abs(y) for _, y, _ in upright) > 9.9 and upright[0][2] == 10, "planes: the behaviour has changed"
PY

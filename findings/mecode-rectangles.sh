#!/usr/bin/env bash
# A good guess: mecode's rect(3, 4) traces a rectangle of that width and height from where the stage is, as its meander() does,
# whether positions are absolute or relative. Found: in absolute positions its four lines go to y = 4, x = 3, y = -4 and x = -3 of the
# axes, wherever the stage was: no rectangle; meander() changes to relative positions and back.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check mecode==0.4.1 numpy==2.4.6
v/bin/python - <<'PY'
import contextlib
import io
from importlib.metadata import version

from mecode import G


def path(absolute, shape):
    """Return the corners that a machine would come by, begun at 20, 10."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        machine = G(print_lines=True)
        machine.absolute()
        machine.move(x=20, y=10)
        if not absolute:
            machine.relative()
        shape(machine)
        machine.teardown()
    place, goes_by, corners = {"X": 0.0, "Y": 0.0}, False, []
    for line in text.getvalue().splitlines():
        words = line.split(";")[0].split()
        if words and words[0] in ("G90", "G91"):
            goes_by = words[0] == "G91"
        elif words and words[0] == "G1":
            for word in words[1:]:
                if word[0] in place:
                    place[word[0]] = float(word[1:]) + (place[word[0]] if goes_by else 0)
            corners.append((place["X"], place["Y"]))
    return corners


rectangles = [path(absolute, lambda machine: machine.rect(3, 4)) for absolute in (False, True)]
meanders = [path(absolute, lambda machine: machine.meander(3, 4, 2)) for absolute in (False, True)]
print("mecode", version("mecode"), "rectangle, relative", rectangles[0], "absolute", rectangles[1])
print("meanders alike:", meanders[0] == meanders[1])
assert rectangles[0] == [(20, 10), (20, 14), (23, 14), (23, 10), (20, 10)], "relative: the behaviour has changed"
assert rectangles[1] == [(20, 10), (20, 4), (3, 4), (3, -4), (-3, -4)], "absolute: the behaviour has changed"
assert meanders[0] == meanders[1], "meanders: the behaviour has changed"
PY

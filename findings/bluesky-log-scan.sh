#!/usr/bin/env bash
# A good guess: bluesky's log_scan from 1 to 3 mm by three points measures at 1, 1.73 and 3 mm, since its page calls the two numbers the starting
# and the ending position of the motor. Found: they are powers of ten. The motor is sent to 10, 100 and 1000 mm, by rel_log_scan that
# much beyond where it is; a scan, with the same numbers, stays between them.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check bluesky==1.15.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

from bluesky import plans


class Stage:
    """A motor for plans that are listed and not run."""

    name, parent, position = "stage", None, 5.0

    def set(self, _value):
        raise AssertionError("only the engine moves it")

    def read(self):
        return {}

    def describe(self):
        return {}


stage = Stage()


def goes_to(plan, back=0):
    """Return where a plan sends the motor, less its way back at the end."""
    places = [float(step.args[0]) for step in plan if step.command == "set"]
    return places[: len(places) - back]


evenly = goes_to(plans.scan([], stage, 1, 3, 3))
by_powers = goes_to(plans.log_scan([], stage, 1, 3, 3))
print("bluesky", version("bluesky"), "scan:", evenly, "log_scan:", by_powers)
print("its page:", [line.strip() for line in plans.log_scan.__doc__.splitlines() if "position of motor" in line])
assert evenly == [1, 2, 3], "scan: the behaviour has changed"
assert by_powers == [10, 100, 1000], "log_scan: the behaviour has changed"
relative = goes_to(plans.rel_log_scan([], stage, 1, 3, 3), back=1)
print("rel_log_scan, begun at", stage.position, "goes to", relative)
assert relative == [15, 105, 1005], "rel_log_scan: the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: the package elliptec sends a Thorlabs ELLx stage to the nearest pulse of its encoder, and a position that it read back to the
# same place. Found: what is behind the point is cut off, after a division that is not exact: of the 61,440 pulses of an ELL20 813 are missed
# by one when asked for by their own position, and a hundred shifts of 0.1 mm, each 102.4 pulses, end 0.039 mm short. And a stage with inch
# threads, 81 in the reply of the protocol's own example, has no thread at all: None. (A stand-in for the serial line answers as the
# protocol's sections IN, MA, MR and PO say.)
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check elliptec==0.1.0
v/bin/python - <<'PY'
from importlib.metadata import version

from elliptec.linear import Linear
from elliptec.tools import parse


class Line:
    """A stage of 60 mm with 1,024 pulses per mm, which is where it was sent."""

    position = 0

    def send_instruction(self, instruction, address="0", message=None):
        if instruction == b"in":
            return parse(b"0IN141234567820231581003C00000400\r\n")
        self.position = message + (self.position if instruction == b"mr" else 0)
        return parse(f"0PO{self.position & 0xFFFFFFFF:08X}\r\n".encode())


line = Line()
stage = Linear(line, debug=False)
missed = [pulse for pulse in range(60 * 1024) if stage.dist_to_pos(pulse / 1024) != pulse]
for _ in range(100):
    reached_mm = stage.shift_distance(0.1)
print("elliptec", version("elliptec"), f"{len(missed)} of {60 * 1024} pulses are missed, from {missed[0]} on, which is sent as", end=" ")
print(f"{stage.dist_to_pos(missed[0] / 1024)}; 100 shifts of 0.1 mm reach {reached_mm} mm; thread: {stage.info['Thread']}")
assert len(missed) == 813 and stage.dist_to_pos(missed[0] / 1024) == missed[0] - 1, "the behaviour has changed"
assert line.position == 10200 and reached_mm == 9.9609, "the behaviour has changed"
assert stage.info["Thread"] is None, "the behaviour has changed"
PY

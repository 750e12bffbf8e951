#!/usr/bin/env bash
# A good guess: the limits of temperature that Adafruit's driver writes into an MCP9808 are what was asked for, also below zero, for it reads its
# temperatures in two's complement, as the sensor's data sheet has both. Found: it writes the magnitude and sets the bit of the sign.
# A lower limit of -10 degrees is one of -246 and below_lower stays False in the coldest freezer; an upper one of -5 is -251, and always passed.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check adafruit-circuitpython-mcp9808==3.3.32 adafruit-blinka==10.0.0
v/bin/python - <<'PY'
from importlib.metadata import version

from adafruit_mcp9808 import MCP9808

UPPER, LOWER, CRITICAL, TEMPERATURE = 2, 3, 4, 5


class Bus:
    """An I2C bus with one MCP9808, which keeps its registers and compares."""

    def __init__(self):
        self.registers = {UPPER: 0, LOWER: 0, CRITICAL: 0, 6: 0x54, 7: 0x400}
        self.degrees = 0

    def degrees_in(self, register):
        return ((self.registers[register] & 0x1FFF ^ 0x1000) - 0x1000) / 16

    def try_lock(self):
        return True

    def unlock(self):
        pass

    def writeto(self, _address, sent, *, start=0, end=None):
        if len(sent[start:end]) == 3:
            self.registers[sent[start]] = int.from_bytes(sent[start + 1 : end], "big")

    def writeto_then_readfrom(self, _address, sent, read, *, out_start=0, out_end=None, in_start=0, in_end=None):
        passed = [
            self.degrees >= self.degrees_in(CRITICAL),
            self.degrees > self.degrees_in(UPPER),
            self.degrees < self.degrees_in(LOWER),
        ]
        flags = sum(one << place for one, place in zip(passed, (15, 14, 13), strict=True))
        self.registers[TEMPERATURE] = int(self.degrees * 16) & 0x1FFF | flags
        count = len(range(*slice(in_start, in_end).indices(len(read))))
        read[in_start:in_end] = self.registers[sent[out_start]].to_bytes(2, "big")[:count]


bus = Bus()
sensor = MCP9808(bus)
kept = {}
for asked in (40, 5, -5, -10, -20):
    sensor.lower_temperature = asked
    kept[asked] = bus.degrees_in(LOWER)
    print("Adafruit's driver", version("adafruit-circuitpython-mcp9808"), "asked for", asked, "written", kept[asked])
sensor.lower_temperature, bus.degrees = -10, -30
read, below = sensor.temperature, sensor.below_lower
sensor.upper_temperature, bus.degrees = -5, -20
sensor.temperature  # noqa: B018
above = sensor.above_upper
print("at", read, "degrees, below a limit of -10:", below, "and at -20 above one of -5:", above)
assert read == -30, "temperatures: the behaviour has changed"
assert kept == {40: 40, 5: 5, -5: -251, -10: -246, -20: -236}, "limits: the behaviour has changed"
assert (below, above) == (False, True), "flags: the behaviour has changed"
PY

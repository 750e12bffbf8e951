#!/usr/bin/env bash
# A good guess: Adafruit's driver for the fan controller EMC2101 sets limits of the external temperature from -64 to 127 degrees, in eighths, as it
# says. Found: it changes the lowest six of the register's eight bits, and no fraction. After a limit of 70 degrees one of 40 is one of
# 104 in the chip, read back as 40: no alarm where one was asked for. 70 itself is read back as 6; after -10, read back as 54, a lower limit of
# 5 is -59.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check adafruit-circuitpython-emc2101==1.2.15 adafruit-blinka==10.0.0
v/bin/python - <<'PY'
from importlib.metadata import version

from adafruit_emc2101.emc2101_ext import EMC2101_EXT

HIGH, LOW, HIGH_EIGHTHS = 0x07, 0x08, 0x13  # whole degrees in two's complement, and eighths in the upper three bits


class Bus:
    """An I2C bus with an EMC2101, which keeps what is written."""

    def __init__(self):
        self.memory = bytearray(256)
        self.memory[0xFD:0xFF] = b"\x16\x5d"

    def try_lock(self):
        return True

    def unlock(self):
        pass

    def writeto(self, _address, sent, *, start=0, end=None):
        sent = bytes(sent[start:end])
        if sent:
            self.memory[sent[0] : sent[0] + len(sent) - 1] = sent[1:]

    def writeto_then_readfrom(self, _address, sent, read, *, out_start=0, out_end=None, in_start=0, in_end=None):
        for place in range(*slice(in_start, in_end).indices(len(read))):
            read[place] = self.memory[sent[out_start] + place - in_start]


bus = Bus()
sensor = EMC2101_EXT(bus)
kept = []
for name, register, asked in (("high", HIGH, 70), ("high", HIGH, 40), ("high", HIGH, 40.5), ("low", LOW, -10), ("low", LOW, 5)):
    setattr(sensor, f"external_temp_{name}_limit", asked)
    degrees = int.from_bytes(bus.memory[register : register + 1], signed=True) + (bus.memory[HIGH_EIGHTHS] / 256 if name == "high" else 0)
    kept.append((asked, degrees, getattr(sensor, f"external_temp_{name}_limit")))
    print("Adafruit's driver", version("adafruit-circuitpython-emc2101"), name, "limit: asked, in the chip, read back:", kept[-1])
assert kept == [(70, 70, 6), (40, 104, 40), (40.5, 104, 40), (-10, -10, 54), (5, -59, 5)], "the behaviour has changed"
PY

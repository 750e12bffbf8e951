#!/usr/bin/env bash
# A good guess: Adafruit's driver for the thermometer and hygrometer HTS221 divides the sensor's own points of calibration, which it stores as eight
# times degrees and twice per cent, by eight and by two. Found: it shifts them, so that what is behind the point is cut off: a sensor
# calibrated at 20.875 and 35.875 degrees is read 0.875 too cold over all of its range, and a humidity of 40.5 % as 40 %.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check adafruit-circuitpython-hts221==1.1.24 adafruit-blinka==10.0.0
v/bin/python - <<'PY'
import struct
from importlib.metadata import version

import adafruit_hts221

COLD, WARM, DRY, WET = 20.875, 35.875, 40.5, 80.5  # the two points of calibration, as the data sheet's registers can hold them
COUNTS = (-1000, 9000)  # what the sensor's converters give at them


class Bus:
    """An I2C bus with one HTS221, calibrated at the points above."""

    def __init__(self):
        self.memory = bytearray(256)
        self.memory[0x0F] = 0xBC
        eights = [int(8 * degrees) for degrees in (COLD, WARM)]
        self.memory[0x30:0x34] = bytes([int(2 * DRY), int(2 * WET), eights[0] & 0xFF, eights[1] & 0xFF])
        self.memory[0x35] = eights[0] >> 8 | eights[1] >> 8 << 2
        for place, counts in zip((0x36, 0x3A, 0x3C, 0x3E), (*COUNTS, *COUNTS), strict=True):
            self.memory[place : place + 2] = struct.pack("<h", counts)
        self.show(0)

    def show(self, share):
        """Have both converters at this share of the way from one point to the other."""
        counts = round(COUNTS[0] + share * (COUNTS[1] - COUNTS[0]))
        self.memory[0x28:0x2C] = struct.pack("<2h", counts, counts)

    def try_lock(self):
        return True

    def unlock(self):
        pass

    def writeto(self, _address, sent, *, start=0, end=None):
        if len(sent[start:end]) == 2 and sent[start] != 0x21:  # the register 0x21 restarts the sensor, at once
            self.memory[sent[start]] = sent[start + 1]

    def writeto_then_readfrom(self, _address, sent, read, *, out_start=0, out_end=None, in_start=0, in_end=None):
        for place in range(*slice(in_start, in_end).indices(len(read))):
            read[place] = self.memory[(sent[out_start] & 0x7F) + place - in_start]


bus = Bus()
sensor = adafruit_hts221.HTS221(bus)
errors = []
for share in (0, 0.5, 1):
    bus.show(share)
    true = (COLD + share * (WARM - COLD), DRY + share * (WET - DRY))
    read = (sensor.temperature, sensor.relative_humidity)
    print("Adafruit's driver", version("adafruit-circuitpython-hts221"), "degrees and per cent", true, "read", read)
    errors.append([round(one - other, 6) for one, other in zip(read, true, strict=True)])
assert errors == [[-0.875, -0.5]] * 3, "the behaviour has changed"
PY

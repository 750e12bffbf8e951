#!/usr/bin/env bash
# A good guess: Adafruit's driver for the three-channel current monitor INA3221 sets the limit of the sum of shunt voltages where it reads it.
# Found: it writes it into another register, the upper limit of valid power: a sum of 0.1 V makes that limit 5 V instead of 10, and
# the sum's own stays as it was, so that no alarm ever comes. And below zero all readings are one step too near to zero: -40 uV are 0.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check adafruit-circuitpython-ina3221==1.2.3 adafruit-blinka==10.0.0
v/bin/python - <<'PY'
from importlib.metadata import version

from adafruit_ina3221 import INA3221

SHUNT_1, SUM_LIMIT, POWER_UPPER, POWER_LOWER = 0x01, 0x0E, 0x10, 0x11


class Bus:
    """An I2C bus with an INA3221: registers of two bytes, with the limits that its data sheet has after a reset."""

    def __init__(self):
        self.kept, self.chosen = dict.fromkeys(range(256), 0) | {SUM_LIMIT: 0x7FFE, POWER_UPPER: 0x2710, POWER_LOWER: 0x2328}, 0

    def try_lock(self):
        return True

    def unlock(self):
        pass

    def writeto(self, _address, sent, *, start=0, end=None):
        sent = bytes(sent[start:end])
        if sent:
            self.chosen = sent[0]
        if len(sent) == 3:
            self.kept[self.chosen] = int.from_bytes(sent[1:], "big")

    def readfrom_into(self, _address, read, *, start=0, end=None):
        read[start:end] = self.kept[self.chosen].to_bytes(2, "big")


bus = Bus()
sensor = INA3221(bus)
before = (round(sensor.shunt_voltage_sum_limit, 3), sensor.power_valid_limits)
sensor.shunt_voltage_sum_limit = 0.1
after = (round(sensor.shunt_voltage_sum_limit, 3), sensor.power_valid_limits)
print("Adafruit's driver", version("adafruit-circuitpython-ina3221"), "limits of the sum and of power, before:", before, "after 0.1:", after)
steps = {}
for step in (2, 1, -1, -2, -100):
    bus.kept[SHUNT_1] = step * 8 & 0xFFFF
    steps[step] = round(sensor[0].shunt_voltage / 0.04, 6)
print("steps of 40 uV and what is read:", steps)
assert before[1] == (9, 10) and after == (before[0], (9, 5)), "limits: the behaviour has changed"
assert steps == {2: 2, 1: 1, -1: 0, -2: -1, -100: -99}, "signs: the behaviour has changed"
PY

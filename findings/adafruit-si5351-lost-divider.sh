#!/usr/bin/env bash
# A good guess: with Adafruit's driver of the clock generator SI5351, a clock's last divider (R), once set, stays when its other divider is set anew.
# Found: it is gone, without a word, for both lie in one register, of which the second writes all bits. A trigger of 23.4 kHz, 1.5 MHz divided
# by 64, whose first divider is doubled, comes at 750 kHz instead of 11.7. R has to be set again after each change.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check adafruit-circuitpython-si5351==1.4.11 adafruit-blinka==10.0.0
v/bin/python - <<'PY'
from importlib.metadata import version

from adafruit_si5351 import R_DIV_64, SI5351


class Bus:
    """An I2C bus with an SI5351, which keeps what is written."""

    def __init__(self):
        self.memory, self.chosen = bytearray(256), 0

    def try_lock(self):
        return True

    def unlock(self):
        pass

    def writeto(self, _address, sent, *, start=0, end=None):
        sent = bytes(sent[start:end])
        if sent:
            self.chosen = sent[0]
            self.memory[sent[0] : sent[0] + len(sent) - 1] = sent[1:]

    def readfrom_into(self, _address, read, *, start=0, end=None):
        for place in range(*slice(start, end).indices(len(read))):
            read[place] = self.memory[self.chosen + place - start]


def hertz(bus):
    """Return what the registers make of the 25 MHz crystal at the first output, by the data sheet's formulas."""

    def ratio(base):
        part = bus.memory[base : base + 8]
        p1 = (part[2] & 3) << 16 | part[3] << 8 | part[4]
        p2 = (part[5] & 15) << 16 | part[6] << 8 | part[7]
        p3 = (part[5] >> 4) << 16 | part[0] << 8 | part[1]
        return (p1 + 512 + p2 / p3) / 128

    return 25e6 * ratio(26) / ratio(42) / 2 ** (bus.memory[44] >> 4 & 7)


bus = Bus()
generator = SI5351(bus)
generator.pll_a.configure_integer(24)
clock, read = generator.clock_0, []
clock.configure_integer(generator.pll_a, 400)
read.append(hertz(bus))
clock.r_divider = R_DIV_64
read.append(hertz(bus))
clock.configure_integer(generator.pll_a, 800)
read.append(hertz(bus))
clock.r_divider = R_DIV_64
read.append(hertz(bus))
print("Adafruit's driver", version("adafruit-circuitpython-si5351"), "clock, with R = 64, with twice the divider, with R again:", read, "Hz")
assert read == [1.5e6, 1.5e6 / 64, 0.75e6, 0.75e6 / 64], "the behaviour has changed"
PY

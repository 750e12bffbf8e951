#!/usr/bin/env bash
# A good guess: Adafruit's driver of the colour sensor OPT4048 takes a threshold in the counts that its channels are read in, and reads back what was
# set. Found: it writes the register as if its lowest step were one count, and it is 256: a threshold of 1000 counts is one of 256,000 in the
# chip, and read back as 256,000. Written back once more it is 65,536,000.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check adafruit-circuitpython-opt4048==1.1.2 adafruit-blinka==10.0.0
v/bin/python - <<'PY'
from importlib.metadata import version

from adafruit_opt4048 import OPT4048

HIGH, IDENTITY = 9, 0x11


class Bus:
    """An I2C bus with an OPT4048: registers of 16 bits; a threshold is its lower 12 bits, moved up by 8 and by its upper 4."""

    def __init__(self):
        self.registers = [0] * 256
        self.registers[IDENTITY] = 0x0821

    def try_lock(self):
        return True

    def unlock(self):
        pass

    def writeto(self, _address, sent, *, start=0, end=None):
        sent = bytes(sent[start:end])
        if len(sent) == 3:
            self.registers[sent[0]] = sent[1] << 8 | sent[2]

    def writeto_then_readfrom(self, _address, sent, read, *, out_start=0, out_end=None, in_start=0, in_end=None):
        held = b"".join(word.to_bytes(2, "big") for word in self.registers[sent[out_start] :][:8])
        places = range(*slice(in_start, in_end).indices(len(read)))
        for place, byte in zip(places, held, strict=False):
            read[place] = byte

    def threshold(self):
        return (self.registers[HIGH] & 0xFFF) << (8 + (self.registers[HIGH] >> 12))


bus = Bus()
sensor = OPT4048(bus)
kept = []
for asked in (1000, 256000):
    sensor.threshold_high = asked
    kept.append((asked, bus.threshold(), sensor.threshold_high))
print("Adafruit's driver", version("adafruit-circuitpython-opt4048"), "threshold: asked, in the chip, read back:", kept)
assert kept == [(1000, 256000, 256000), (256000, 65536000, 65536000)], "the behaviour has changed"
PY

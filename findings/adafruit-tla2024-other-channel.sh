#!/usr/bin/env bash
# A good guess: with Adafruit's driver of the four-channel converter TLA2024 an AnalogIn gives its own pin's voltage, whatever was read before, and a
# channel that was set is read back. Found: once `value` of any pin has been read, `voltage` of all pins is what that pin had at that
# moment: of pins at 0.5, 1, 1.5 and 2 V all four say 0.5 V, and still do after the voltages have changed. And channel 2, once set, is
# read back as 6.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check adafruit-circuitpython-tla202x==1.0.23 adafruit-blinka==10.0.0
v/bin/python - <<'PY'
from importlib.metadata import version

from adafruit_tla202x import TLA2024
from adafruit_tla202x.analog_in import AnalogIn


class Bus:
    """An I2C bus with a TLA2024 that has always just converted the input that is chosen, 12 bits in the upper ones of a register."""

    def __init__(self):
        self.volts, self.configuration = [0.5, 1.0, 1.5, 2.0], 0x8583

    def try_lock(self):
        return True

    def unlock(self):
        pass

    def writeto(self, _address, sent, *, start=0, end=None):
        sent = bytes(sent[start:end])
        if len(sent) == 3 and sent[0] == 1:
            self.configuration = sent[1] << 8 | sent[2]

    def writeto_then_readfrom(self, _address, sent, read, *, out_start=0, out_end=None, in_start=0, in_end=None):
        if sent[out_start] == 1:  # bit 15, read, is 0 while it converts: the driver waits for a 0 and goes on at once
            word = self.configuration & 0x7FFF
        else:
            full = {0: 6.144, 1: 4.096, 2: 2.048}[self.configuration >> 9 & 7]
            word = round(self.volts[(self.configuration >> 12 & 7) - 4] / full * 2048) << 4
        places = range(*slice(in_start, in_end).indices(len(read)))
        for place, byte in zip(places, word.to_bytes(2, "big"), strict=False):
            read[place] = byte


bus = Bus()
converter = TLA2024(bus)
pins = [AnalogIn(converter, number) for number in range(4)]
before = [round(pin.voltage, 2) for pin in pins]
count = pins[0].value
after = [round(pin.voltage, 2) for pin in pins]
bus.volts = [3.0] * 4
later = [round(pin.voltage, 2) for pin in pins]
converter.input_channel = 2
print("Adafruit's driver", version("adafruit-circuitpython-tla202x"), "voltages", before, "after a value of pin 0", after, end=" ")
print("and at 3 V", later, "; channel 2 is read as", converter.input_channel)
assert before == [0.5, 1.0, 1.5, 2.0] and after == [0.5] * 4 and later == [0.5] * 4, "voltages: the behaviour has changed"
assert converter.input_channel == 6, "channels: the behaviour has changed"
PY

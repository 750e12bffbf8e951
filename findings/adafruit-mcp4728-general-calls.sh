#!/usr/bin/env bash
# A good guess: Adafruit's driver of the fourfold converter MCP4728 resets it by reset() and lets all four outputs follow by soft_update(), and a gain that
# it reads can be written back. Found: the data sheet's general calls go to address 0 of the bus; the driver sends a 0 and the call's byte to
# the converter's own address, which is its fast write: reset() sets output A to 6 of 4095, soft_update() to 8, wakeup() to 9, and
# nothing else happens. And a gain of 2 is read as 1, and one of 1 as 0, which cannot be written.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check adafruit-circuitpython-mcp4728==1.3.16 adafruit-blinka==10.0.0
v/bin/python - <<'PY'
from importlib.metadata import version

from adafruit_mcp4728 import MCP4728


class Bus:
    """An I2C bus with an MCP4728 at address 0x60, by its data sheet's table of commands; general calls go to address 0."""

    def __init__(self):
        self.codes, self.gains, self.calls = [0] * 4, [0] * 4, []

    def try_lock(self):
        return True

    def unlock(self):
        pass

    def writeto(self, address, sent, *, start=0, end=None):
        sent = bytes(sent[start:end])
        if not sent:
            return
        if address == 0:
            self.calls.append(sent[0])
        elif sent[0] >> 6 == 0:  # fast write: 0 0 PD1 PD0 D11..D8, D7..D0, for channel A and those after it
            for channel in range(len(sent) // 2):
                self.codes[channel] = (sent[2 * channel] & 15) << 8 | sent[2 * channel + 1]
        elif sent[0] >> 3 == 0b01000:  # one channel: its number, then reference, power, gain and code
            self.codes[sent[0] >> 1 & 3] = (sent[1] & 15) << 8 | sent[2]
        elif sent[0] >> 4 == 0b1100:
            self.gains = [sent[0] >> (3 - channel) & 1 for channel in range(4)]

    def readfrom_into(self, _address, read, *, start=0, end=None):
        for channel in range(4):
            page = (0xC0 + 16 * channel, self.gains[channel] << 4 | self.codes[channel] >> 8, self.codes[channel] & 255)
            read[6 * channel : 6 * channel + 6] = bytes(2 * page)


bus = Bus()
converter = MCP4728(bus)
found = {}
for name in ("reset", "soft_update", "wakeup"):
    for channel in (converter.channel_a, converter.channel_b):
        channel.raw_value = 2000
    assert bus.codes == [2000, 2000, 0, 0]
    getattr(converter, name)()
    found[name] = bus.codes[:2]
print("Adafruit's driver", version("adafruit-circuitpython-mcp4728"), "outputs A and B, 2000 each before, after", found, end=" ")
print("general calls on the bus:", bus.calls)
assert found == {"reset": [6, 2000], "soft_update": [8, 2000], "wakeup": [9, 2000]} and not bus.calls, "calls: the behaviour has changed"
converter.channel_a.gain = 2
read = converter.channel_a.gain
converter.channel_a.gain = read
again = converter.channel_a.gain
print("gain 2 is read as", read, "and then, written back, as", again, "gain bits in the chip", bus.gains)
assert (read, again, bus.gains[0]) == (1, 0, 0), "gains: the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: Adafruit's driver of the converters DAC5578 to DAC7578 sets which outputs wait for the LDAC pin by ldac_mask and by a channel's ldac, and
# resets by reset(). Found: the mask is sent with the command that was sent last: after output 3 was set to half, a mask of 4 sets output 3 to a
# sixty-fourth of full scale, and the chip's own mask stays. The mask that is read is the upper byte of what was sent last, 128 here.
# And reset() sends the code for the CLR pin, not the reset's: all outputs stay where they are.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check adafruit-circuitpython-dacx578==1.0.3 adafruit-blinka==10.0.0
v/bin/python - <<'PY'
from importlib.metadata import version

from adafruit_dacx578 import DACx578


class Bus:
    """An I2C bus with a DAC7578: a command in the upper and a channel in the lower half of the first byte, and two bytes of data."""

    def __init__(self):
        self.outputs, self.mask, self.resets = [0] * 8, 0, 0

    def try_lock(self):
        return True

    def unlock(self):
        pass

    def writeto(self, _address, sent, *, start=0, end=None):
        sent = bytes(sent[start:end])
        if len(sent) < 3:
            return
        command, channel = sent[0] >> 4, sent[0] & 15
        if command == 0b0011:  # write to the channel and update it: twelve bits, left-aligned
            self.outputs[channel] = (sent[1] << 8 | sent[2]) >> 4
        elif command == 0b0110:
            self.mask = sent[1]
        elif command == 0b0111:
            self.resets, self.outputs = self.resets + 1, [0] * 8


bus = Bus()
converter = DACx578(bus)
converter.channels[3].raw_value = 2048
read = converter.ldac_mask
converter.ldac_mask = 4
by_mask, driver = bus.outputs[3], converter.channels[3].raw_value
print("Adafruit's driver", version("adafruit-circuitpython-dacx578"), "mask read after 2048 was set:", read, end=" ")
print("output after a mask of 4:", by_mask, "by the driver:", driver, "mask in the chip:", bus.mask)
assert (read, by_mask, driver, bus.mask) == (128, 64, 2048, 0), "masks: the behaviour has changed"
converter.channels[5].raw_value = 2048
converter.channels[0].ldac = False
print("output 5 after 2048 and ldac = False of channel 0:", bus.outputs[5])
assert bus.outputs[5] == 2064, "a channel's mask: the behaviour has changed"
converter.reset()
print("outputs after reset():", bus.outputs, "resets:", bus.resets)
assert bus.outputs[3] == 64 and bus.resets == 0, "reset: the behaviour has changed"
PY

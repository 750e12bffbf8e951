#!/usr/bin/env bash
# A good guess: spin-stepper drives ST's stepper driver L6470 by its data sheet's commands. Found: to go on until a switch closes, or is released, and to
# mark the place there it sets bit 2 of the command, where the data sheet has bit 3: the chip knows no command 0x87, and nothing moves.
# A mark below zero is refused when its first byte is out already: the chip takes the next command, here to go to 100, for the place of the mark,
# and stands. And voltages and speeds of 0, all within the data sheet's ranges, are not written: a motor asked to hold with none holds on.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps spin-stepper==0.1.0
v/bin/python - <<'PY'
import typing
from importlib.metadata import version

typing.override = getattr(typing, "override", lambda function: function)  # which Python 3.11, that the package allows, lacks
from spin_stepper import SpinChain, SpinDirection

BYTES = {0x40: 3, 0x50: 3, 0x60: 3, 0x68: 3, 0x82: 3, 0x8A: 3}  # that follow moves, runs and GoUntil; the last without bit 0, the direction
REGISTERS = {0x01: 3, 0x03: 3, 0x08: 2, 0x09: 1, 0x0A: 1, 0x0E: 1}
PLAIN = {0x70, 0x78, 0x92, 0x9A, 0xA0, 0xA8, 0xB0, 0xB8, 0xC0, 0xD8}


class Chip:
    """An L6470 on SPI, by its data sheet's table 38: GoUntil is 1000 ACT 01 DIR, ReleaseSW 1001 ACT 01 DIR."""

    def __init__(self):
        self.left, self.told, self.done, self.unknown, self.registers = 0, [], [], [], {}

    def transfer(self, sent):
        byte = sent[0]
        if self.left:
            self.told.append(byte)
            self.left -= 1
        elif byte in REGISTERS:
            self.told, self.left = [byte], REGISTERS[byte]
        elif byte & 0xFE in BYTES:
            self.told, self.left = [byte], BYTES[byte & 0xFE]
        elif byte in PLAIN or byte & 0xFE in PLAIN:
            self.told = [byte]
        elif byte:
            self.unknown.append(hex(byte))
            return [0]
        if self.told and not self.left:
            self.done.append(hex(self.told[0]))
            self.registers[self.told[0]] = int.from_bytes(self.told[1:], "big")
            self.told = []
        return [0]


chip = Chip()
motor = SpinChain(1, spi_transfer=chip.transfer).create(0)
motor.go_until(direction=SpinDirection.Forward, speed=100)
motor.release_switch(direction=SpinDirection.Forward)
without = chip.done, chip.unknown
chip = Chip()
motor = SpinChain(1, spi_transfer=chip.transfer).create(0)
motor.release_switch(set_mark=True, direction=SpinDirection.Forward)
motor.go_until(set_mark=True, direction=SpinDirection.Forward, speed=0)
print("spin-stepper", version("spin-stepper"), "commands done and unknown without marks:", *without, "with marks:", chip.done, chip.unknown)
assert without == (["0x83", "0x93"], []) and chip.unknown == ["0x97", "0x87"] and not chip.done, "marks: the behaviour has changed"

chip = Chip()
motor = SpinChain(1, spi_transfer=chip.transfer).create(0)
motor.mark = 100
motor.go_to(100)
before = chip.done, chip.registers[0x03]
assert before == (["0x3", "0x60"], 100)
try:
    motor.mark = -100
    raise SystemExit("negative marks: the behaviour has changed")
except ValueError as error:
    found = str(error)
chip.done.clear()
motor.go_to(100)
mark = (chip.registers[0x03] + 2**21) % 2**22 - 2**21
print("a mark at -100:", found, "; going to 100 after that: done", chip.done, "mark", mark, "unknown", chip.unknown)
assert found == "value must be non-negative" and (chip.done, mark, chip.unknown) == (["0x3"], -(2**21), ["0x64"]), "negative marks: the behaviour has changed"

chip = Chip()
motor = SpinChain(1, spi_transfer=chip.transfer).create(0)
motor.set_kval(kval_hold=0.5)
motor.set_kval(kval_hold=0.0)
motor.set_speed_limits(min_speed=100.0)
least = chip.registers[0x08]
motor.set_speed_limits(min_speed=0.0)
print("holding at half the voltage, then at none:", chip.registers[0x09], "of 255; least speed:", least, "then", chip.registers[0x08])
assert chip.registers[0x09] == 128 and chip.registers[0x08] == least > 0, "zeros: the behaviour has changed"
PY

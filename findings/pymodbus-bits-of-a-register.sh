#!/usr/bin/env bash
# A good guess: pymodbus' convert_from_registers with DATATYPE.BITS gives the bits of a drive's status word as manuals count them: the first
# of the list is bit 0, the one of value 1. Found: the upper byte's come first: 0x0001 is the list's ninth, 0x0100 its first, so
# that "ready" and "fault" of a status word change places with bits 8 on; convert_to_registers writes a command word so, too, while
# a round trip hides it, and fills up the list that it is given. INT16 and UINT16 are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pymodbus==3.16.1
v/bin/python - <<'PY'
from importlib.metadata import version

from pymodbus.client import ModbusTcpClient

kind = ModbusTcpClient.DATATYPE
places = {}
for bit in range(16):
    bits = ModbusTcpClient.convert_from_registers([1 << bit], kind.BITS)
    places[bit] = [place for place, is_set in enumerate(bits) if is_set]
command = [True, False, True]
written = ModbusTcpClient.convert_to_registers(command, kind.BITS)
number = ModbusTcpClient.convert_to_registers(5, kind.UINT16)
print("pymodbus", version("pymodbus"), "bit: place in the list", {bit: place for bit, (place,) in places.items()})
print("bits 0 and 2 as a register", hex(written[0]), "of the number 5", hex(number[0]), "the list of three has now", len(command))
assert all(place == [(bit + 8) % 16] for bit, place in places.items()), "reading: the behaviour has changed"
assert written == [0x0500] and number == [0x0005], "writing: the behaviour has changed"
assert ModbusTcpClient.convert_from_registers(written, kind.BITS)[:3] == [True, False, True], "round trips: the behaviour has changed"
assert len(command) == 16, "the caller's list: the behaviour has changed"
PY

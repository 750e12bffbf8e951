#!/usr/bin/env bash
# A good guess: pyubx2 writes a value into a message of a u-blox receiver as the nearest that the message can hold, so that what it reads, it writes
# again. Found: it divides by the message's step and cuts: a limit of 0.3 for the dilution of precision is sent as 0.2 (348 of 1000 tenths are one too
# low), a fixed height of 0.29 m as 0.28 (an eighth of the centimetres). Of 2000 messages NAV-DOP, read and built again from what was read, 253 are
# others, and 0.58 is 0.57, then 0.56, with each passage. Latitudes and longitudes come back right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps pyubx2==1.4.0 pyrtcm==1.2.1 pynmeagps==1.1.8
v/bin/python - <<'PY'
import struct
from importlib.metadata import version

from pyubx2 import GET, SET, UBXMessage, UBXReader


def sent(name, value):
    """Return the value that a receiver reads in the setting that is sent to it."""
    message = UBXMessage("CFG", "CFG-NAV5", SET, **{name: value})
    return getattr(UBXReader.parse(message.serialize(), msgmode=SET), name)


def again(message):
    """Return the message that is built from what is read in this one."""
    read = UBXReader.parse(message.serialize())
    names = [name for name in vars(read) if not name.startswith("_") and name != "iTOW"]
    return UBXMessage("NAV", message.identity, GET, iTOW=0, **{name: getattr(read, name) for name in names})


lower = {
    "pDop": [tenths for tenths in range(1000) if abs(sent("pDop", tenths / 10) - tenths / 10) > 1e-6],
    "fixedAlt": [hundredths for hundredths in range(1000) if abs(sent("fixedAlt", hundredths / 100) - hundredths / 100) > 1e-6],
}
others = {"NAV-DOP": 0, "NAV-POSLLH": 0}
for count in range(2000):
    for name, payload in (("NAV-DOP", struct.pack("<I7H", 0, *[count] * 7)), ("NAV-POSLLH", struct.pack("<IiiiiII", 0, 90_000_000 + count, 510_000_000 + count, 0, 0, 0, 0))):
        message = UBXMessage("NAV", name, GET, payload=payload)
        others[name] += again(message).payload != message.payload
passes = [0.58]
for _ in range(3):
    passes.append(UBXReader.parse(UBXMessage("NAV", "NAV-DOP", GET, gDOP=passes[-1]).serialize()).gDOP)
print("pyubx2", version("pyubx2"), "sent: pDop of 0.3 as", sent("pDop", 0.3), "; fixedAlt of 0.29 m as", sent("fixedAlt", 0.29), "; too low of 1000:", {name: len(values) for name, values in lower.items()})
print("messages of 2000 that are others when built again:", others, "; a dilution from one message to the next:", passes)
assert others["NAV-POSLLH"] == 0 and sent("pDop", 2.5) == 2.5
assert (sent("pDop", 0.3), sent("fixedAlt", 0.29)) == (0.2, 0.28), "the behaviour has changed"
assert len(lower["pDop"]) == 348 and 100 < len(lower["fixedAlt"]) < 150, "the behaviour has changed"
assert others["NAV-DOP"] == 253 and passes == [0.58, 0.57, 0.56, 0.56], "the behaviour has changed"
PY

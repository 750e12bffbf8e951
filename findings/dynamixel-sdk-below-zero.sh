#!/usr/bin/env bash
# A good guess: read4ByteTxRx() of ROBOTIS's dynamixel-sdk gives a Dynamixel's present position as the signed number that the control table's page says
# it is, as write4ByteTxRx() takes a goal of -100. Found: -100 comes back as 4294967196, a present current of -5 as 65531, and so from
# GroupSyncRead; the difference to a goal below zero is 4294967296 too large. A motor at the other end of a line is played by protocol 2.0.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check dynamixel-sdk==4.1.0 pyserial==3.5
v/bin/python - <<'PY'
import os
import pty
import struct
import threading
import tty
from importlib.metadata import version

from dynamixel_sdk import GroupSyncRead, PacketHandler, PortHandler

kept = {126: struct.pack("<h", -5)}  # present current


def check(data):
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x8005) & 0xFFFF if value & 0x8000 else value << 1
    return value


def motor(line):
    """Answers writes, reads and synchronous reads of motor 1; the position follows the goal at once."""
    waiting = b""
    while True:
        waiting += os.read(line, 1000)
        while len(waiting) >= 7 and len(waiting) >= (size := 7 + int.from_bytes(waiting[5:7], "little")):
            packet, waiting = waiting[:size], waiting[size:]
            address, data = int.from_bytes(packet[8:10], "little"), b""
            if packet[7] == 0x03:
                kept[132 if address == 116 else address] = packet[10:-2]
            else:
                data = kept[address][: int.from_bytes(packet[10:12], "little")]
            body = b"\x55\x00" + data
            head = b"\xff\xff\xfd\x00\x01" + struct.pack("<H", len(body) + 2) + body
            os.write(line, head + struct.pack("<H", check(head)))


device, computer = pty.openpty()
tty.setraw(device), tty.setraw(computer)
threading.Thread(target=motor, args=(device,), daemon=True).start()
port, packets = PortHandler(os.ttyname(computer)), PacketHandler(2.0)
port.baudrate = 57600
assert port.openPort()
packets.write4ByteTxRx(port, 1, 116, -100)
position, current = packets.read4ByteTxRx(port, 1, 132)[0], packets.read2ByteTxRx(port, 1, 126)[0]
group = GroupSyncRead(port, packets, 132, 4)
group.addParam(1)
assert group.txRxPacket() == 0
print("dynamixel-sdk", version("dynamixel-sdk"), "goal -100, sent as", struct.unpack("<i", kept[132])[0], "read as", position, "in a group", group.getData(1, 132, 4), "; current of -5 as", current)
assert struct.unpack("<i", kept[132])[0] == -100
assert position == group.getData(1, 132, 4) == 4294967196 and current == 65531, "the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: a whole number that a caproto server publishes as pvproperty(value=0) and that outgrows EPICS's 32 bits is refused when written, as
# one beyond a limit is. Found: it is taken, and the server has it right, but sends its lowest 32 bits: a clock of 2 147 483 648 us, 36 minutes,
# is read by clients as -2147483648, 2**40 as 0, with no warning. A value of 2.7 stays 2.7 in the server and is 2 for its clients. As
# pvproperty(value=0.0) both are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check caproto==1.3.0 numpy==2.4.6
v/bin/python -W error - <<'PY'
import asyncio
from importlib.metadata import version

from caproto import ChannelDouble, ChannelInteger
from caproto.server import PVGroup, pvproperty


class Camera(PVGroup):
    clock_us = pvproperty(value=0)
    exact_us = pvproperty(value=0.0)


camera = Camera(prefix="camera:")
whole, double = (camera.pvdb["camera:" + name] for name in ("clock_us", "exact_us"))
assert isinstance(whole, ChannelInteger) and isinstance(double, ChannelDouble)


async def sent(channel, value):
    """Return what the server holds and what it sends to a client that asks for the channel's own kind of value."""
    await channel.write(value)
    _, data = await channel.read(channel.data_type)
    return channel.value, data[0].item()


async def main():
    return {value: (await sent(whole, value), await sent(double, value)) for value in (2**31 - 1, 2**31, 2**40, 2.7)}


read = asyncio.run(main())
for value, (of_whole, of_double) in read.items():
    print("caproto", version("caproto"), "written", value, "held and sent, whole:", of_whole, "double:", of_double)
assert [read[value][0] for value in (2**31 - 1, 2**31, 2**40)] == [(2**31 - 1,) * 2, (2**31, -(2**31)), (2**40, 0)], "the behaviour has changed"
assert read[2.7][0] == (2.7, 2), "fractions: the behaviour has changed"
assert all(of_double == (value, value) for value, (_, of_double) in read.items()), "doubles: the behaviour has changed"
PY

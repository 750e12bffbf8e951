#!/usr/bin/env bash
# A good guess: c10 copy of c10-tools cuts a recording (IRIG 106 chapter 10) from a beginning to an end, where an end in bytes is "the offset
# from <start>", and times may be relative or absolute. Found: of bytes from S on and L long it copies S + L, for S is added twice: of 60 packets, 20
# asked for from the 20th on are all 40 that are left. An absolute beginning is compared as one of the year 1900, so that the copy starts with
# the file. The day of an absolute end is counted in 1900, too, so that from March of a leap year on it is a day late: an end in the
# middle of a file on day 100 cuts nothing. Relative times are right. It is called here as the command calls it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps c10-tools==1.1.4 pychapter10==1.1.19 bitstring==3.1.9 bitstruct==8.24.0 tqdm==4.70.1
v/bin/python - <<'PY'
from contextlib import redirect_stderr
from datetime import datetime, timedelta
from importlib.metadata import version
from io import StringIO
from pathlib import Path

from c10_tools.copy import main as copy
from chapter10 import C10
from chapter10.time import TimeF1

FEBRUARY, APRIL = datetime(2024, 2, 19, 12), datetime(2024, 4, 9, 12)  # days 50 and 100 of a leap year


def write(name, first):
    """Write 60 packets of time, one a second, with month and year."""
    packets = []
    for second in range(60):
        packet = TimeF1(data_type=0x11, channel_id=1, sequence_number=second, rtc=second * 10_000_000, date_format=1, leap=1)
        packet.time = first + timedelta(seconds=second)
        packets.append(bytes(packet))
    Path(name).write_bytes(b"".join(packets))
    assert len({len(packet) for packet in packets}) == 1
    return len(packets[0])


def cut(name, begin, start=None, end=None):
    """Return the seconds of the packets that are copied."""
    with redirect_stderr(StringIO()):
        copy({"<src>": name, "<dst>": "cut.c10", "<start>": start, "<end>": end, "--force": True})
    return [round((packet.time - begin).total_seconds()) for packet in C10("cut.c10")]


length = write("february.c10", FEBRUARY)
write("april.c10", APRIL)
found = {
    "bytes, 20 packets": cut("april.c10", APRIL, end=str(20 * length)),
    "bytes, 20 packets from packet 20 on": cut("april.c10", APRIL, str(20 * length), str(20 * length)),
    "relative times, 20 s and 20 s more": cut("april.c10", APRIL, "00:00:20.0", "00:00:20.0"),
    "absolute times, from 20 to 40 s, day 50": cut("february.c10", FEBRUARY, "050:12:00:20.0", "050:12:00:40.0"),
    "absolute end, 40 s, day 100": cut("april.c10", APRIL, end="100:12:00:40.0"),
}
for name, seconds in found.items():
    print("c10-tools", version("c10-tools"), f"{name}: {len(seconds)} packets, from {seconds[0]} to {seconds[-1]} s")
ends = {name: (len(seconds), seconds[0], seconds[-1]) for name, seconds in found.items()}
assert ends["bytes, 20 packets"] == (20, 0, 19) and ends["relative times, 20 s and 20 s more"] == (21, 20, 40)
assert ends["bytes, 20 packets from packet 20 on"] == (40, 20, 59), "bytes: the behaviour has changed"
assert ends["absolute times, from 20 to 40 s, day 50"] == (41, 0, 40), "absolute beginnings: the behaviour has changed"
assert ends["absolute end, 40 s, day 100"] == (60, 0, 59), "absolute ends: the behaviour has changed"
PY

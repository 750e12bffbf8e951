#!/usr/bin/env bash
# A good guess: spe2py names what a LightField file (SPE 3.0) keeps beside each frame as the file does: there each number follows the next, in the
# order in which the footer lists them, two times of the exposure and then the frame's number. Found: it takes the names in alphabetical
# order. The time of the exposure's start is called FrameTrackingNumber, its end ExposureStarted, the frame's number ExposureEnded.
# And it reads the count of frames, four bytes, as two: of 70000 frames 4464 are there, without a word. (Seen with NumPy 1; with NumPy 2.4
# files that have such numbers beside their frames are a ValueError.)
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check --no-deps spe2py==2.0.0 untangle==1.3.0 defusedxml==0.7.1 numpy==1.26.4
v/bin/python - <<'PY'
import struct
from importlib.metadata import version

from spe_loader import SpeFile

WIDTH, HEIGHT = 4, 2


def footer(frames):
    size = 2 * WIDTH * HEIGHT
    time = '<TimeStamp event="Exposure{}" type="Int64" bitDepth="64" resolution="1000000" absoluteTime="2030-01-01T00:00:00Z"/>'
    parts = ("DataHistories", "DataHistory", "Origin", "Experiment", "Devices", "Cameras", "Camera", "ReadoutControl")
    parts += ("RegionsOfInterest", "CustomRegions")
    return (
        '<?xml version="1.0" encoding="utf-8"?><SpeFormat version="3.0"><DataFormat>'
        f'<DataBlock type="Frame" count="{frames}" pixelFormat="MonochromeUnsigned16" size="{size}" stride="{size + 24}" metaFormat="1">'
        f'<DataBlock type="Region" count="1" width="{WIDTH}" height="{HEIGHT}" size="{size}" stride="{size}"/></DataBlock></DataFormat>'
        f'<MetaFormat><MetaBlock id="1">{time.format("Started")}{time.format("Ended")}'
        '<FrameTrackingNumber type="Int64" bitDepth="64"/></MetaBlock></MetaFormat><Calibrations/>'
        + "".join(f"<{part}>" for part in parts)
        + f'<RegionOfInterest x="0" y="0" width="{WIDTH}" height="{HEIGHT}" xBinning="1" yBinning="1"/>'
        + "".join(f"</{part}>" for part in reversed(parts))
        + "</SpeFormat>"
    )


def write(frames):
    """Write frames of their own number, exposed from 1000 k to 1000 k + 500 us."""
    body = b"".join(
        struct.pack(f"<{WIDTH * HEIGHT}H3q", *[k % 65536] * (WIDTH * HEIGHT), 1000 * k, 1000 * k + 500, k + 1)
        for k in range(frames)
    )
    head = bytearray(4100)
    for place, kind, value in ((108, "h", 3), (42, "H", WIDTH), (656, "H", HEIGHT), (1446, "i", frames), (1992, "f", 3.0)):
        struct.pack_into("<" + kind, head, place, value)
    struct.pack_into("<Q", head, 678, len(head) + len(body))
    with open("run.spe", "wb") as file:
        file.write(head + body + footer(frames).encode())


write(3)
read = SpeFile("run.spe")
named = {name: read.metadata[:, column].tolist() for column, name in enumerate(read.metanames)}
print("spe2py", version("spe2py"), named)
assert [int(frame[0][0, 0]) for frame in read.data] == [0, 1, 2], "pictures: the behaviour has changed"
assert named["FrameTrackingNumber"] == [0, 1000, 2000], "names: the behaviour has changed"
assert named["ExposureStarted"] == [500, 1500, 2500] and named["ExposureEnded"] == [1, 2, 3], "names: the behaviour has changed"
write(70000)
count = len(SpeFile("run.spe").data)
print("of 70000 frames:", count)
assert count == 70000 % 65536, "the count: the behaviour has changed"
PY

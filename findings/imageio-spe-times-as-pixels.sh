#!/usr/bin/env bash
# A good guess: imageio reads the frames of a LightField film (SPE 3.0, Princeton Instruments) as they are, whether or not LightField was told to
# keep each frame's times and number: it knows version 3, and the description at the file's end says how far apart frames lie. Found: what
# is kept behind each frame is read as pixels of the next: with two times and a number, 24 bytes, frame k begins with the numbers of the one
# before and lies 12 k pixels too far right, further at each frame. It warns only from where they add up to a whole frame. (Without them:
# right.)
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check --no-deps imageio==2.38.1 numpy==2.4.6 pillow==13.0.0
v/bin/python - <<'PY'
import struct
import warnings

import imageio
import imageio.v3 as iio
import numpy as np

WIDTH, HEIGHT, FRAMES = 64, 48, 100
BAR = 40  # the column of a bright line in each frame


def frame(number):
    picture = np.full((HEIGHT, WIDTH), number, "<u2")
    picture[:, BAR] = 4000
    return picture


def write(kept):
    """Write FRAMES frames and, if asked, the exposure's start and end in microseconds and the frame's number behind each."""
    size, names = 2 * WIDTH * HEIGHT, ("ExposureStarted", "ExposureEnded")
    times = [f'<TimeStamp event="{name}" type="Int64" bitDepth="64" resolution="1000000"/>' for name in names]
    parts = times + ['<FrameTrackingNumber type="Int64" bitDepth="64"/>']
    footer = (
        '<?xml version="1.0" encoding="utf-8"?><SpeFormat version="3.0"><DataFormat>'
        f'<DataBlock type="Frame" count="{FRAMES}" pixelFormat="MonochromeUnsigned16" size="{size}" stride="{size + 24 * kept}"'
        + (' metaFormat="1">' if kept else ">")
        + f'<DataBlock type="Region" count="1" width="{WIDTH}" height="{HEIGHT}" size="{size}" stride="{size}"/></DataBlock></DataFormat>'
        + (f'<MetaFormat><MetaBlock id="1">{"".join(parts)}</MetaBlock></MetaFormat>' if kept else "")
        + "</SpeFormat>"
    )
    body = b""
    for number in range(FRAMES):
        body += frame(number).tobytes() + (struct.pack("<3q", 1000 * number, 1000 * number + 500, number + 1) if kept else b"")
    head = bytearray(4100)
    for place, kind, value in ((108, "h", 3), (42, "H", WIDTH), (656, "H", HEIGHT), (1446, "i", FRAMES), (1992, "f", 3.0)):
        struct.pack_into("<" + kind, head, place, value)
    struct.pack_into("<Q", head, 678, len(head) + len(body))
    with open("run.spe", "wb") as file:
        file.write(head + body + footer.encode())


def read():
    """Return whether all frames are right, the column of the line in frames 0, 1 and 2, frame 1's first pixels and what was said."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        film = iio.imread("run.spe", plugin="SPE")
    right = np.array_equal(film, [frame(number) for number in range(FRAMES)])
    columns = [int(np.flatnonzero(film[number][HEIGHT // 2] == 4000)[0]) for number in range(3)]
    return film.shape, right, columns, film[1].ravel()[:12].tolist(), [str(one.message) for one in said]


write(kept=False)
plain = read()
write(kept=True)
kept = read()
print("imageio", imageio.__version__, "without times:", plain)
print("with times:", kept)
assert plain[:3] == ((FRAMES, HEIGHT, WIDTH), True, [40, 40, 40]), "the behaviour has changed"
assert kept[0] == (FRAMES, HEIGHT, WIDTH) and not kept[1] and kept[2] == [40, 52, 0], "the behaviour has changed"
assert kept[3] == [0, 0, 0, 0, 500, 0, 0, 0, 1, 0, 0, 0] and kept[4] == [], "the behaviour has changed"
PY

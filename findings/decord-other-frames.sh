#!/usr/bin/env bash
# A good guess: decord, made for random access, gives frame i for vr[i], however slowly. Found: of H.264 in MPEG-TS, as camcorders write it, vr[0] is
# the second key frame, all others are as late, and the last one stands in for those that are missing, so that their number is right. In AVI, and in MP4
# with open groups of pictures, frames are right in order from the first on, and others if asked for singly or backwards: a group early, or up to three
# frames late. Not a word is said. PyAV reads all of them right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check decord==0.6.0 av==18.1.0 numpy==2.4.6
cat > look.py <<'PY'
import av
import decord
import numpy as np

COUNT = 60


def write(path, **options):
    with av.open(path, "w") as file:
        stream = file.add_stream("libx264", rate=25, options=options)
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = 64, 48, "yuv420p", 12
        for i in range(COUNT):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 4 * i, np.uint8), format="rgb24")
            frame.pts = i
            file.mux(stream.encode(frame))
        file.mux(stream.encode())


def number(picture):
    return round(float(picture.mean()) / 4)


def by_decord(path, order):
    reader = decord.VideoReader(path, num_threads=1)
    assert len(reader) == COUNT
    found = {i: number(reader[i].asnumpy()) for i in order}
    return [found[i] for i in range(COUNT)]


def wrong(numbers):
    return {i: found for i, found in enumerate(numbers) if found != i}


inorder, backwards = {}, {}
for path, options in (("closed.mp4", {}), ("open.mp4", {"x264-params": "open-gop=1"}), ("plain.avi", {}), ("plain.ts", {})):
    write(path, **options)
    with av.open(path) as file:
        assert [number(frame.to_ndarray(format="rgb24")) for frame in file.decode(video=0)] == list(range(COUNT))
    inorder[path] = wrong(by_decord(path, range(COUNT)))
    backwards[path] = wrong(by_decord(path, reversed(range(COUNT))))
    print(path, "in order wrong", len(inorder[path]), list(inorder[path].items())[:3], "backwards", len(backwards[path]), list(backwards[path].items())[:3])
print("decord", decord.__version__, "of", COUNT, "frames, as (asked, got)")
assert not inorder["closed.mp4"] and not backwards["closed.mp4"]
assert not inorder["open.mp4"] and 4 <= len(backwards["open.mp4"]) <= 16, "the behaviour has changed"
assert not inorder["plain.avi"] and len(backwards["plain.avi"]) == 48 and backwards["plain.avi"][12] == 0, "the behaviour has changed"
late = inorder["plain.ts"]
assert [late[i] for i in range(40)] == list(range(12, 52)) and all(late[i] == 59 for i in range(50, 59)), "the behaviour has changed"
PY
v/bin/python look.py

#!/usr/bin/env bash
# In an MP4 of VP9, ffmpeg believes the box `vpcC` about primaries and transfer, but about the matrix of YUV it believes the
# stream: with vpcC saying BT.601 and the stream saying nothing (as OpenCV writes both), the film is "unknown/bt709/...".
# A good guess: the container's word holds for all three. To tag the matrix, each key frame has to be changed.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT; cd "$place"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 opencv-contrib-python-headless==5.0.0.93 imageio-ffmpeg==0.6.0
v/bin/python - <<'PY'
import re, subprocess, sys
import cv2, imageio_ffmpeg, numpy as np
print("opencv-contrib-python-headless", cv2.__version__, "and ffmpeg", imageio_ffmpeg.get_ffmpeg_version())
writer = cv2.VideoWriter("film.mp4", cv2.VideoWriter.fourcc(*"vp09"), 24, (64, 48))
for k in range(5):
    writer.write(np.full((48, 64, 3), 40 * k, np.uint8))
writer.release()
def told(film):
    open("asked.mp4", "wb").write(film)
    said = subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), "-i", "asked.mp4"], capture_output=True, text=True).stderr
    return re.search(r"Video: .*?yuv420p\(([^)]*)\)", said)[1]
film = open("film.mp4", "rb").read()
at = film.find(b"vpcC") + 4 + 4 + 3
boxed = film[:at] + bytes((1, 13, 6)) + film[at + 3:]                 # BT.709, sRGB, matrix of BT.601
streamed = re.sub(rb"([\x80-\x83]\x49\x83\x42)(.)", lambda m: m[1] + bytes([m[2][0] & 31 | 3 << 5]), boxed, flags=re.S)
seen = told(film), told(boxed), told(streamed)
for name, words in zip(("as OpenCV writes it:", "vpcC changed:       ", "key frames as well: "), seen):
    print(name, words)
sys.exit(not ("unknown/bt709" in seen[1] and "smpte170m/bt709" in seen[2]))
PY

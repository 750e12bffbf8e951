#!/usr/bin/env bash
# A good guess: ffmpegcv, which writes films as OpenCV does and takes any codec of ffmpeg, keeps colours by a codec without loss
# (FFV1, raw video), and refuses or crops a film of odd width. Found: whatever the codec can do, the film is YUV 4:2:0 unless that
# cannot be: columns of red and blue are up to 175 of 255 off in FFV1 and raw video, right in PNG; and
# a film of odd size by its default codec is a file without a picture: write() and release() say nothing.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check ffmpegcv==0.3.20 imageio-ffmpeg==0.6.0 av==18.1.0 numpy==2.4.6
ln -s "$(v/bin/python -c 'import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())')" v/bin/ffmpeg
PATH="$folder/v/bin:$PATH" v/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

import av
import ffmpegcv
import numpy as np

rows, columns = np.indices((48, 64))
picture = np.where((columns % 2 == 0)[..., None], [40, 40, 200], [200, 120, 40]).astype(np.uint8)


def write(name, codec, frame):
    film = ffmpegcv.VideoWriter(name, codec, 30)
    for _ in range(5):
        film.write(frame)
    film.release()


lost = {}
for codec in ("ffv1", "rawvideo", "png"):
    write(f"{codec}.mkv", codec, picture)
    with av.open(f"{codec}.mkv") as film:
        seen = next(film.decode(video=0))
        lost[codec] = seen.format.name, int(abs(seen.to_ndarray(format="bgr24").astype(int) - picture).max())
write("odd.mp4", "h264", np.ascontiguousarray(picture[:47, :63]))
size = Path("odd.mp4").stat().st_size if Path("odd.mp4").exists() else 0
print("ffmpegcv", version("ffmpegcv"), "codec: format, largest difference", lost, "bytes of a film of 63 x 47", size)
assert lost["ffv1"][0] == lost["rawvideo"][0] == "yuv420p" and min(lost["ffv1"][1], lost["rawvideo"][1]) > 50, "codecs: it has changed"
assert lost["png"][1] == 0, "PNG has changed"
assert size < 300, "odd sizes: the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: a grey clip encoded without loss (H.264, qp 0, pixel format gray) by PyAV comes back as it was. Found: it is stored in full
# range without saying so, and read as colour of limited range: levels up to 16 become 0, those from 235 on 255, 40 becomes 28. By way of
# yuv420p each level comes back to 1; by FFV1 all do.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check av==18.1.0 numpy==2.4.6
v/bin/python - <<'PY'
import av
import numpy as np

levels = np.repeat(np.arange(256, dtype=np.uint8).reshape(1, 256), 64, axis=0)


def back(codec, pixel_format):
    with av.open("clip.mkv", "w") as clip:
        stream = clip.add_stream(codec, rate=1, options={"qp": "0"} if codec == "libx264" else {})
        stream.width, stream.height, stream.pix_fmt = 256, 64, pixel_format
        clip.mux(stream.encode(av.VideoFrame.from_ndarray(levels, format="gray")))
        clip.mux(stream.encode())
    with av.open("clip.mkv") as clip:
        return next(clip.decode(video=0)).to_ndarray(format="gray")[0].astype(int)


grey, colour, ffv1 = back("libx264", "gray"), back("libx264", "yuv420p"), back("ffv1", "gray")
print("PyAV", av.__version__, "40 becomes", grey[40], "black", (grey == 0).sum(), "white", (grey == 255).sum(), "by yuv420p at most", abs(colour - levels[0]).max())
assert grey[40] == 28 and (grey == 0).sum() == 17 and (grey == 255).sum() == 21, "the behaviour has changed"
assert abs(colour - levels[0]).max() <= 1 and np.array_equal(ffv1, levels[0]), "the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: pygigevision, an implementation of the GigE Vision protocol in Python, receives the pictures of any such camera, or says what it
# cannot. Found: pictures of more than 2048 x 2048 pixels never arrive, with a line in the log of "invalid dimensions". And it takes each format
# that it does not know for two bytes a pixel: of the 8-bit mosaics of colour cameras (BayerRG8) it makes one pixel of two,
# with 16 bits, the lower half black. Seen at packets over the loopback, as the standard has them.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pygigevision==0.2.2 numpy==2.4.6
v/bin/python - <<'PY'
import logging
import socket
import struct
import time
from importlib.metadata import version

import numpy as np
from pyGigEVision.gvsp import GVSPReceiver

MONO8, BAYER_RG8 = 0x01080001, 0x01080009
logging.disable(logging.CRITICAL)


def received(picture, pixel_format, packet, seconds=30):
    """Send a picture in packets of so many bytes and return what comes, with what is said about it."""
    receiver = GVSPReceiver(local_ip="127.0.0.1", packet_size=packet + 8, frame_retention=60)
    receiver.start()
    camera = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(kind, number, payload):
        camera.sendto(struct.pack(">HHI", 0, 1, kind << 24 | number) + payload, ("127.0.0.1", receiver.port))
        time.sleep(0.003)

    height, width = picture.shape
    send(1, 0, struct.pack(">HHQIIIIIHH", 0, 1, 1000, pixel_format, width, height, 0, 0, 0, 0))
    pixels = picture.tobytes()
    parts = [pixels[begin : begin + packet] for begin in range(0, len(pixels), packet)]
    for number, part in enumerate(parts, 1):
        send(3, number, part)
    send(2, len(parts) + 1, struct.pack(">HHI", 0, 1, height))
    came = receiver.get_frame_with_info(timeout=seconds)
    receiver.stop()
    receiver.close()
    camera.close()
    return came


small = np.arange(16 * 24, dtype=np.uint8).reshape(16, 24)
grey, _ = received(small, MONO8, 96)
mosaic, told = received(small, BAYER_RG8, 96)
largest = received(np.zeros((1024, 4096), np.uint8), MONO8, 60000)
larger = received(np.zeros((1025, 4096), np.uint8), MONO8, 60000, seconds=5)
print("pygigevision", version("pygigevision"), "grey:", grey.dtype, grey.shape, "mosaic:", mosaic.dtype, mosaic.shape)
print("the mosaic's first pixels:", mosaic[0, :3], "from", small[0, :6], "complete:", told["complete"])
print("4096 x 1024:", "none" if largest is None else largest[0].shape, "4096 x 1025:", "none" if larger is None else larger[0].shape)
assert np.array_equal(grey, small), "grey: the behaviour has changed"
assert mosaic.dtype == np.uint16 and np.array_equal(mosaic[:8].reshape(-1), small.view("<u2").reshape(-1)), "the behaviour has changed"
assert not mosaic[8:].any() and not told["complete"], "mosaics: the behaviour has changed"
assert largest is not None and larger is None, "large pictures: the behaviour has changed"
PY

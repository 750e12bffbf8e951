#!/usr/bin/env bash
# A good guess: adafruit_gps gives a receiver's time to the fraction of a second that it sends, and a place also as degrees and minutes, "for full
# precision", with the sign of the south and the west. Found: times are whole seconds, cut: ten fixes a second have one time. And within a
# degree of Greenwich or the equator the sign is gone, for it is at the degrees alone, which are 0: 0 degrees 31 minutes west is east.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check adafruit-circuitpython-gps==4.0.0 adafruit-blinka==10.0.0
v/bin/python - <<'PY'
import functools
import operator
from importlib.metadata import version

from adafruit_gps import GPS


class Line:
    """A serial line on which a receiver has sent one sentence."""

    def __init__(self, sentence):
        self.waiting = sentence

    @property
    def in_waiting(self):
        return len(self.waiting)

    def readline(self):
        sent, self.waiting = self.waiting, b""
        return sent


def fix(time, longitude, side):
    body = f"GNRMC,{time},A,4807.0381,N,{longitude},{side},000.5,054.7,230330,,,A"
    sum_of_bits = functools.reduce(operator.xor, body.encode())
    receiver = GPS(Line(f"${body}*{sum_of_bits:02X}\r\n".encode()))
    assert receiver.update()
    return receiver


moments = [fix(f"123519.{tenth}00", "01131.0000", "E").timestamp_utc for tenth in range(10)]
seconds = sorted({moment.tm_sec for moment in moments})
places = {}
for longitude, side in (("01131.0000", "W"), ("00031.0000", "W"), ("00031.0000", "E")):
    receiver = fix("123519.000", longitude, side)
    places[longitude, side] = (receiver.longitude, receiver.longitude_degrees, receiver.longitude_minutes)
print("adafruit_gps", version("adafruit-circuitpython-gps"), "ten fixes from 12:35:19.0 to 19.9, seconds:", seconds)
print("longitude, its degrees and its minutes:", places)
assert seconds == [19], "times: the behaviour has changed"
assert places["01131.0000", "W"] == (-11.516666, -11, 31), "degrees: the behaviour has changed"
assert places["00031.0000", "W"][0] < 0 and places["00031.0000", "W"][1:] == places["00031.0000", "E"][1:] == (0, 31), "the behaviour has changed"
PY

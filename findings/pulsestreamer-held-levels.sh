#!/usr/bin/env bash
# A good guess: two sequences of Swabian's Pulse Streamer added are the first and then the second, and durations are rounded to its nanoseconds.
# Found: a channel that the second leaves out keeps the first one's last level for all of it, while the second alone has it low: a shutter
# stays open. And durations are cut: thirteen periods of 0.1 us, 13 * 1e-7 * 1e9, are 1299 ns.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pulsestreamer==2.1.2
v/bin/python - <<'PY'
from importlib.metadata import version

from pulsestreamer import Sequence

SHUTTER, TRIGGER = 0, 1
first, second, periods = Sequence(), Sequence(), Sequence()
first.setDigital(SHUTTER, [(100, 1)])
second.setDigital(TRIGGER, [(50, 1), (50, 0)])
periods.setDigital(TRIGGER, [(13 * 1e-7 * 1e9, 1)])


def shutter_ns(sequence):
    return sum(step[0] for step in sequence.getData() if step[1] >> SHUTTER & 1)


alone, added = shutter_ns(first) + shutter_ns(second), shutter_ns(first + second)
duration = int(periods.getDuration())
print("pulsestreamer", version("pulsestreamer"), f"open for {alone} ns one after the other, {added} ns added; 1300 ns last {duration} ns")
assert (alone, added) == (100, 200) and duration == 1299, "the behaviour has changed"
PY

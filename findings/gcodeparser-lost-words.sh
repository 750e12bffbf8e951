#!/usr/bin/env bash
# A good guess: gcodeparser's lines hold every word of a program for a stage, or it says what it did not understand. Found: a command with a
# digit after the point (G38.2, G43.1, G92.1) loses that digit and all its words, words after a comment in parentheses are lost, and a line
# that goes on with the last command ("X1 Y2") is left out, each without a word: the rest looks like a shorter sweep.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check gcodeparser==0.3.0
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

from gcodeparser import GcodeParser

found = {text: [line.gcode_str for line in GcodeParser(text).lines] for text in ("G38.2 Z-10 F50", "G1 X1 (far side) Y2", "G1 X1 F100\nX2\nX3")}
for text, lines in found.items():
    print("gcodeparser", version("gcodeparser"), repr(text), "becomes", lines)
assert list(found.values()) == [["G38"], ["G1 X1"], ["G1 X1 F100"]], "the behaviour has changed"
PY

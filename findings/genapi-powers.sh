#!/usr/bin/env bash
# A good guess: formulas in a camera's GenICam description, whose operator `**` is that of Fortran and Python, follow their rules:
# 2 ** 3 ** 2 is 2 ** 9, and -2 ** 2 is -4.
# Found: GenApi's reference implementation (genicam 1.6.0) takes powers from the left, (2 ** 3) ** 2 = 64, and lets the sign
# bind closer, (-2) ** 2 = 4. Who works out a camera's formula by another program (gain in dB, temperatures by polynomials)
# gets other numbers, with the wrong sign at worst. Brackets agree everywhere.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet genicam==1.6.0
"$folder/venv/bin/python" - <<'PY'
from importlib.metadata import version

from genicam.genapi import NodeMap

HEAD = """<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="M" VendorName="V" StandardNameSpace="None" SchemaMajorVersion="1" SchemaMinorVersion="1"
 SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" ToolTip=""
 ProductGuid="11111111-2222-3333-4444-555555555555" VersionGuid="11111111-2222-3333-4444-555555555555"
 xmlns="http://www.genicam.org/GenApi/Version_1_1">
<Category Name="Root"><pFeature>Feature</pFeature></Category>"""


def value_of(formula):
    nodes = NodeMap()
    knife = f'<SwissKnife Name="Feature"><Formula>{formula}</Formula></SwissKnife>'
    nodes.load_xml_from_string(HEAD + knife + "</RegisterDescription>")
    return nodes.get_node("Feature").value


found = {formula: value_of(formula) for formula in ("2 ** 3 ** 2", "-2 ** 2", "2 ** (3 ** 2)", "-(2 ** 2)")}
print("genicam", version("genicam"), found, "Python", {formula: eval(formula) for formula in found})
assert found["2 ** (3 ** 2)"] == 512 and found["-(2 ** 2)"] == -4
assert (found["2 ** 3 ** 2"], found["-2 ** 2"]) == (64, 4), "the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: in a camera's GenICam description an IntConverter (a whole number by formulas) may leave its <Slope> out, as a
# Converter may: it then is Automatic, the limits follow from the formulas, and the feature can be written.
# Found: GenApi's reference implementation (genicam 1.6.0) then gives it the limits 0 and 0, and refuses every other value as
# larger than 0, although it reads the right one. `<Slope>Automatic</Slope>` written out gives the right limits. What is
# written between two steps is cut to the lower one without a word, though the increment is said to be 1; the Converter with
# the same formulas goes to the nearest. So a feature that "cannot be set" may be a missing word in the camera's file.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet genicam==1.6.0
"$folder/venv/bin/python" - <<'PY'
from importlib.metadata import version

from genicam.genapi import AbstractPort, EAccessMode, NodeMap, OutOfRangeException

HEAD = """<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="M" VendorName="V" StandardNameSpace="None" SchemaMajorVersion="1" SchemaMinorVersion="1"
 SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" ToolTip=""
 ProductGuid="11111111-2222-3333-4444-555555555555" VersionGuid="11111111-2222-3333-4444-555555555555"
 xmlns="http://www.genicam.org/GenApi/Version_1_1">
<Category Name="Root"><pFeature>Feature</pFeature></Category>
<IntReg Name="Raw"><Address>0</Address><Length>2</Length><AccessMode>RW</AccessMode><pPort>Device</pPort>
<Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"""


class Registers(AbstractPort):
    def __init__(self):
        super().__init__()
        self.memory = bytearray(16)

    def write(self, address, data):
        self.memory[address : address + len(data)] = bytes(data)

    def read(self, address, length):
        return bytes(self.memory[address : address + length])

    def get_access_mode(self):
        return EAccessMode.RW


def look(kind, slope):
    """The value that a raw 5 reads as, the limits, and what raw value and value 42 leave behind."""
    body = f'<{kind} Name="Feature"><FormulaTo>FROM/4</FormulaTo><FormulaFrom>TO*4</FormulaFrom><pValue>Raw</pValue>{slope}</{kind}>'
    nodes, registers = NodeMap(), Registers()
    nodes.load_xml_from_string(HEAD + body + '<Port Name="Device"/></RegisterDescription>')
    nodes.connect(registers, "Device")
    raw, feature = nodes.get_node("Raw"), nodes.get_node("Feature")
    raw.value = 5
    read = feature.value
    try:
        feature.value = 42
    except OutOfRangeException:
        return read, (feature.min, feature.max), None
    return read, (feature.min, feature.max), (raw.value, feature.value)


for kind in ("IntConverter", "Converter"):
    for slope in ("", "<Slope>Automatic</Slope>"):
        print("genicam", version("genicam"), kind, slope or "no slope", look(kind, slope))
assert look("Converter", "") == look("Converter", "<Slope>Automatic</Slope>") == (20, (0, 262140), (11, 44))
assert look("IntConverter", "<Slope>Automatic</Slope>") == (20, (0, 262140), (10, 40)), "the behaviour has changed"
assert look("IntConverter", "") == (20, (0, 0), None), "the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: a wheel of any platform that carries Standa's library for Debian and macOS can be imported there. Found: since 3.1, libximc
# imports Windows' registry at its first line and stops on everything else; 3.0.4, with the same libraries, opens its virtual axis.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv old; old/bin/pip install --quiet --disable-pip-version-check libximc==3.0.4
python3 -m venv new; new/bin/pip install --quiet --disable-pip-version-check libximc==3.1.2
old/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

import libximc.highlevel as ximc

axis = ximc.Axis("xi-emu:///" + str(Path("axis.bin").resolve()))
axis.open_device()
print("libximc", version("libximc"), "position of a virtual axis:", axis.get_position().Position)
axis.close_device()
PY
new/bin/python - <<'PY'
from importlib.metadata import files, version

libraries = [str(file) for file in files("libximc") if file.name in ("libximc.so", "libbindy.dylib")]
print("libximc", version("libximc"), "carries", libraries)
missing = ""
try:
    import libximc.highlevel
except ModuleNotFoundError as error:
    missing = error.name
    print("import on this system:", error)
assert len(libraries) >= 2 and missing == "winreg", "the behaviour has changed"
PY

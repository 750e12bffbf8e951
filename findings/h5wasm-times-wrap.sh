#!/usr/bin/env bash
# A good guess: h5wasm writes a list of whole numbers, such as times in milliseconds, as it writes a list with fractions: each as it is.
# Found: if no number of the list has a fraction, all are written as 32 bits with a sign, whatever they are: 1700000000000 ms becomes -807049216,
# and a count of 4 billion -294967296, in data sets and in attributes, with no word. A list with one fraction in it is right. Read back with h5py.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 h5py==3.16.0
npm install --silent --no-audit --no-fund h5wasm@0.10.3
cat > write.mjs <<'JS'
import h5wasm from "h5wasm/node";
await h5wasm.ready;
const file = new h5wasm.File("times.h5", "w");
file.create_dataset({ name: "whole", data: [1700000000000, 1700000000033] });
file.create_dataset({ name: "half", data: [1700000000000, 1700000000033.5] });
file.create_dataset({ name: "count", data: [4000000000] });
file.create_attribute("began", 1700000000000);
file.close();
JS
node write.mjs
v/bin/python - <<'PY'
import h5py

with h5py.File("times.h5") as file:
    read = {name: file[name][()].tolist() for name in file} | {"began": int(file.attrs["began"])}
    print("h5wasm 0.10.3", {name: file[name].dtype.name for name in file}, read)
assert read["half"] == [1700000000000, 1700000000033.5]
assert read["whole"] == [-807049216, -807049183] and read["count"] == [-294967296], "the behaviour has changed"
assert read["began"] == -807049216, "attributes: the behaviour has changed"
PY

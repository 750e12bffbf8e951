#!/usr/bin/env bash
# A good guess: netcdfjs gives as many values of a variable of NetCDF 3 as its dimensions say, and the format's bytes, which are signed, as
# such. Found: what pads values of one or two bytes to multiples of four is returned as values: three shorts a record come as four, the fourth
# of whatever pads, three characters as four; bytes come as 254 for -2, each in an array of its own if they are no record's. Sizes that are multiples of
# four bytes hide it, but for the sign. netCDF4 and SciPy read each right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check netCDF4==1.7.5.1.post1 scipy==1.17.1 numpy==2.4.6
echo '{"private": true}' > package.json
npm install --silent --no-fund --no-audit netcdfjs@4.0.0 > npm.log 2>&1
cat > write.py <<'PY'
import netCDF4
import numpy as np
from scipy.io import netcdf_file

with netCDF4.Dataset("some.nc", "w", format="NETCDF3_CLASSIC") as file:
    for name, size in (("frame", None), ("three", 3), ("four", 4)):
        file.createDimension(name, size)
    for name, kind, axes, values in (
        ("bytes", "i1", ("three",), [1, -2, 3]),
        ("bytes4", "i1", ("four",), [1, -2, 3, -4]),
        ("letters", "S1", ("three",), list("abc")),
        ("shorts", "i2", ("frame", "three"), [[1, 2, 3], [4, 5, 6]]),
        ("shorts4", "i2", ("frame", "four"), [[1, 2, 3, 4], [5, 6, 7, 8]]),
        ("floats", "f4", ("frame", "three"), [[1, 2, 3], [4, 5, 6]]),
    ):
        file.createVariable(name, kind, axes)[:] = np.array(values, "S1" if kind == "S1" else kind)
with netcdf_file("some.nc", "r", mmap=False) as file:
    assert file.variables["bytes"][:].tolist() == [1, -2, 3] and file.variables["shorts"][:].tolist() == [[1, 2, 3], [4, 5, 6]]
PY
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { readFileSync } from 'node:fs'
import { NetCDFReader } from 'netcdfjs'
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})

const reader = new NetCDFReader(readFileSync('some.nc'))
const read = Object.fromEntries(reader.variables.map(({ name }) => [name, reader.getDataVariable(name)]))
for (const [name, values] of Object.entries(read)) console.log('netcdfjs 4.0.0', name.padEnd(8), JSON.stringify(values))
assert.deepStrictEqual(read.floats, [[1, 2, 3], [4, 5, 6]])
assert.deepStrictEqual(read.shorts4, [[1, 2, 3, 4], [5, 6, 7, 8]])
const shorts = read.shorts.map((record) => [record.length, ...record.slice(0, 3)])
assert.deepStrictEqual(shorts, [[4, 1, 2, 3], [4, 4, 5, 6]], 'the behaviour has changed')
assert.strictEqual(read.letters.length, 4, 'the behaviour has changed')
assert.deepStrictEqual([read.bytes.length, ...read.bytes.slice(0, 3).flat()], [4, 1, 254, 3], 'the behaviour has changed')
assert.deepStrictEqual(read.bytes4.flat(), [1, 254, 3, 252], 'the behaviour has changed')
JS
v/bin/python write.py
node look.mjs

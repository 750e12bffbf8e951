#!/usr/bin/env bash
# A good guess: three.js's VTKLoader reads the faces, coordinates and colours of a small mesh that VTK itself wrote, or refuses what it does not know. Found: VTK writes version
# 5.1 of its format, in which faces are two arrays; the loader takes each line of these for a face of as many corners as its first number says: of a plane's six squares nine
# triangles come, all wrong. Binary coordinates in double precision are read as single: a square of 1 x 1 m is 15 billion km long. And colours of faces, not of points, are
# made linear twice: 0.5 is 0.04.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check vtk==9.7.2 numpy==2.4.6
npm install --silent --no-fund --no-audit three@0.187.0 > npm.log 2>&1
v/bin/python - <<'PY'
import vtk

print("VTK", vtk.vtkVersion().GetVTKVersion())
plane = vtk.vtkPlaneSource()
plane.SetResolution(3, 2)


def write(name, version, binary, precision):
    plane.SetOutputPointsPrecision(precision)
    plane.Update()
    bare = vtk.vtkPolyData()
    bare.SetPoints(plane.GetOutput().GetPoints())
    bare.SetPolys(plane.GetOutput().GetPolys())
    writer = vtk.vtkPolyDataWriter()
    writer.SetInputData(bare)
    writer.SetFileName(name)
    writer.SetFileType(vtk.VTK_BINARY if binary else vtk.VTK_ASCII)
    if version:
        writer.SetFileVersion(version)
    assert writer.Write() == 1


write("older.vtk", vtk.vtkDataWriter.VTK_LEGACY_READER_VERSION_4_2, False, vtk.vtkAlgorithm.SINGLE_PRECISION)
write("usual.vtk", None, False, vtk.vtkAlgorithm.SINGLE_PRECISION)
write("doubles.vtk", vtk.vtkDataWriter.VTK_LEGACY_READER_VERSION_4_2, True, vtk.vtkAlgorithm.DOUBLE_PRECISION)
PY
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { readFileSync } from 'node:fs'
import { REVISION } from 'three'
import { VTKLoader } from 'three/examples/jsm/loaders/VTKLoader.js'
console.warn = () => {}

function parse(content) {
  const geometry = new VTKLoader().parse(new Uint8Array(content).buffer)
  geometry.computeBoundingBox()
  return geometry
}
const [older, usual, doubles] = ['older', 'usual', 'doubles'].map((name) => parse(readFileSync(`${name}.vtk`)))
const triangles = (geometry) => geometry.index.count / 3
const size = (geometry) => geometry.boundingBox.max.clone().sub(geometry.boundingBox.min).toArray().map((n) => +n.toPrecision(2))
function greyOf(kind, count) {
  const head = ['# vtk DataFile Version 3.0', 'grey'.padEnd(200, '-'), 'ASCII', 'DATASET POLYDATA', 'POINTS 3 float', '0 0 0', '1 0 0', '0 1 0', 'POLYGONS 1 4', '3 0 1 2']
  const colours = [`${kind} ${count}`, 'COLOR_SCALARS grey 3', ...Array(count).fill('0.5 0.5 0.5'), '']
  return +parse(new TextEncoder().encode([...head, ...colours].join('\n'))).attributes.color.array[0].toFixed(3)
}
const [ofPoints, ofFaces] = [greyOf('POINT_DATA', 3), greyOf('CELL_DATA', 1)]
console.log(`three r${REVISION}: triangles of six squares: ${triangles(older)} from version 4.2, ${triangles(usual)} from 5.1;`)
console.log(`size in single precision ${size(older).join(' x ')}, in double ${size(doubles).join(' x ')}; grey of 0.5: of points ${ofPoints}, of faces ${ofFaces}`)
assert.deepStrictEqual([triangles(older), size(older)], [12, [1, 1, 0]])
assert(triangles(usual) === 9 && triangles(doubles) === 12, 'the behaviour has changed')
assert(size(doubles)[0] > 1.5, 'the behaviour has changed')
assert.deepStrictEqual([ofPoints, ofFaces], [0.214, 0.038], 'the behaviour has changed')
JS
node look.mjs || exit 1

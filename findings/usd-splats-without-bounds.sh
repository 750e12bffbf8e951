#!/usr/bin/env bash
# A good guess: OpenUSD finds the bounds of its own Gaussians (ParticleField3DGaussianSplat, a Boundable) from positions
# and scales where a file states no extent, as it does for Points, Spheres and Meshes.
# Found: usd-core 26.11 has no such computation. The bound is empty, without a warning, so that "frame all", culling and
# usdrecord's camera see nothing of a scene of splats; the same positions as Points have a bound. A writer has to state
# the extent itself.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet usd-core==26.11
"$folder/venv/bin/python" - <<'PY'
from pxr import Gf, Usd, UsdGeom, UsdVol

stage = Usd.Stage.CreateInMemory()
places, sizes = [Gf.Vec3f(0, 0, 0), Gf.Vec3f(10, 0, 0)], [Gf.Vec3f(1, 1, 1), Gf.Vec3f(2, 2, 2)]
splats = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/splats")
splats.CreatePositionsAttr(places)
splats.CreateScalesAttr(sizes)
splats.CreateOrientationsAttr([Gf.Quatf(1, 0, 0, 0)] * 2)
splats.CreateOpacitiesAttr([1.0, 0.5])
points = UsdGeom.Points.Define(stage, "/points")
points.CreatePointsAttr(places)
points.CreateWidthsAttr([2.0, 4.0])


def bound(prim):
    return UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default"]).ComputeWorldBound(prim.GetPrim()).ComputeAlignedRange()


print("usd-core", ".".join(map(str, Usd.GetVersion())), "splats", bound(splats), "points", bound(points))
assert splats.GetPrim().IsA(UsdGeom.Boundable)
assert bound(points).GetMax()[0] == 12 and not bound(points).IsEmpty()
assert bound(splats).IsEmpty(), "the behaviour has changed"
splats.CreateExtentAttr([Gf.Vec3f(-1, -2, -2), Gf.Vec3f(12, 2, 2)])
assert bound(splats).GetMax()[0] == 12, "a stated extent is not used"
PY

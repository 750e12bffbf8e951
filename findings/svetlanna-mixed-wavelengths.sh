#!/usr/bin/env bash
# A good guess: SVETlANNa's four methods of propagation through free space give the same light, each wavelength (or picture of a batch) in its
# place. Found: by RSC and zpRSC, which its warnings recommend for longer ways, the results of several wavelengths change places: of three, the
# first comes out last and the others one earlier, with no word; and on grids of even size the picture moves by half a pixel along both axes.
# (The shift after the inverse Fourier transform is along all axes of the array; the kernel's centre lies between pixels.) One wavelength and
# one picture at a time, on grids of odd size, are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check svetlanna==2.0.2 torch==2.13.0 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import svetlanna
import torch

PIXEL = 20e-6
found = {}
for size in (63, 64):
    axis = (torch.arange(size) - (size - 1) / 2) * PIXEL
    grid = svetlanna.SimulationParameters(x=axis, y=axis, wavelength=torch.tensor([450e-9, 550e-9, 650e-9]))
    spot = torch.exp(-(axis[None] ** 2 + axis[:, None] ** 2) / (2 * 150e-6**2))
    light = svetlanna.Wavefront((spot * torch.tensor([1.0, 2.0, 3.0])[:, None, None]).to(torch.complex64))
    for method in ("ASM", "zpASM", "RSC", "zpRSC"):
        arrived = svetlanna.elements.FreeSpace(grid, distance=0.05, method=method)(light).abs() ** 2
        power = arrived.sum((1, 2))
        column = (arrived * axis).sum((1, 2)) / power / PIXEL
        found[size, method] = [round(float(value)) for value in 9 * power / power.max()], float(column.mean())
        print(f"SVETlANNa {version('svetlanna')} {size} pixels, {method}: powers of 1, 4 and 9 arrive as {found[size, method][0]}, centre at {found[size, method][1]:.2f} px")
right = [found[size, method] for size in (63, 64) for method in ("ASM", "zpASM")]
mixed = {size: [found[size, method] for method in ("RSC", "zpRSC")] for size in (63, 64)}
assert all(powers == [1, 4, 9] and abs(centre) < 0.01 for powers, centre in right), "the angular spectrum is wrong, too"
assert all(powers == [4, 9, 1] for size in (63, 64) for powers, _ in mixed[size]), "wavelengths: the behaviour has changed"
assert all(abs(centre) < 0.01 for _, centre in mixed[63]), "odd sizes: the behaviour has changed"
assert all(-0.55 < centre < -0.4 for _, centre in mixed[64]), "half a pixel: the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: deepinv's HyperSpectralUnmixing takes other endmembers in a call, as its pages say, and then inverts with them; and prox_l2() of Decolorize
# keeps a picture that agrees with its measurement. Found: A() and A_adjoint() use the endmembers of the call, A_dagger() goes on inverting the first ones:
# abundances of 0 to 1 come back wrong by 1 and more. prox_l2() of Decolorize gives any picture one hue, that of its weights: what the measurement does not see
# is lost, where that of Inpainting keeps it; iterations by proximal steps lose their colours.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check deepinv==0.5.0 torch==2.14.1 torchvision==0.29.1 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import torch
from deepinv import physics

torch.manual_seed(0)
own = version("deepinv")
first, other = torch.rand(3, 8), torch.rand(3, 8)
shares = torch.rand(1, 3, 4, 4)
mixing = physics.HyperSpectralUnmixing(M=first.clone())
off = [float((mixing.A_dagger(mixing.A(shares)) - shares).abs().max())]
seen = mixing.A(shares, M=other.clone())
back = mixing.A_adjoint(seen, M=other.clone())
right = float((seen - torch.einsum("ec,behw->bchw", other, shares)).abs().max()), float((back - torch.einsum("ec,bchw->behw", other, seen)).abs().max())
off.append(float((mixing.A_dagger(seen, M=other.clone()) - shares).abs().max()))
off.append(float((physics.HyperSpectralUnmixing(M=other.clone()).A_dagger(seen) - shares).abs().max()))
print("deepinv", own, "abundances are off by", off[0], ", with other endmembers in the calls by", off[1], ", with an operator made of those by", off[2])
picture = torch.rand(1, 3, 8, 8)
kept = {}
for operator in (physics.Decolorize(), physics.Inpainting(img_size=(3, 8, 8), mask=0.5)):
    name = type(operator).__name__
    near = operator.prox_l2(picture, operator.A(picture), gamma=1.0)
    slope = operator.A_adjoint(operator.A(near) - operator.A(picture)) + near - picture
    kept[name] = float((near - picture).abs().max()), float(slope.abs().max())
    print(name, "prox_l2 of a picture that agrees with its measurement moves it by", kept[name][0], ", where the slope of what it minimises is", kept[name][1])
ratio = physics.Decolorize().prox_l2(picture, physics.Decolorize().A(picture), gamma=1.0)
ratio = ratio / ratio[:, :1]
print("ratios of its colours:", ratio.amin((0, 2, 3)).tolist(), "to", ratio.amax((0, 2, 3)).tolist())
assert off[0] < 1e-4 and off[2] < 1e-4 and max(right) < 1e-5 and max(kept["Inpainting"]) < 1e-5
assert off[1] > 0.5, "unmixing: the behaviour has changed"
assert min(kept["Decolorize"]) > 0.3 and torch.allclose(ratio.amin((0, 2, 3)), ratio.amax((0, 2, 3)), atol=1e-4), "prox_l2: the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: of deepinv's PoissonLikelihood, the data term for photon noise, `grad` is the gradient of its `fn` and `prox` is where
# `fn` and the squared distance are least together, as with its other data terms. Found: the gradient is too large by the gain's square
# (of a gain of 0.1 a hundredth of what it should be); `prox` multiplies by a root that is to be added, so that it is -7.55 where 0.83
# is right, at a gain of 1 too, and ignores the background; and the value of one picture in a batch holds a part of the others'.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check deepinv==0.5.0 torch==2.14.1 numpy==2.4.6
v/bin/python -W ignore - <<'PY'
import deepinv
import torch
from deepinv.optim.data_fidelity import L2, PoissonLikelihood

torch.manual_seed(0)
y = torch.rand(1, 1, 4, 4, dtype=torch.float64) + 0.2
x = torch.rand_like(y) + 0.3


def slope_of(term):
    at = x.clone().requires_grad_()
    term.fn(at, y).sum().backward()
    return at.grad


def nearest(gain, step):
    """Where step (z / gain - y / gain log(z / gain)) + (z - x)^2 / 2 is least."""
    half = (x - step / gain) / 2
    return half + (half**2 + step * y / gain).sqrt()


ratio, lost = {}, {}
for gain in (0.1, 1.0, 2.0):
    term = PoissonLikelihood(gain=gain, bkg=0.0, denormalize=True).d
    quotient = term.grad(x, y) / slope_of(term)
    ratio[gain] = round(float(quotient.min()), 4), round(float(quotient.max()), 4)
    lost[gain] = [round(float(value), 2) for value in (term.prox(x, y, gamma=0.3)[0, 0, 0, 0], nearest(gain, 0.3)[0, 0, 0, 0])]
term = PoissonLikelihood(gain=1.0, denormalize=False).d
right = nearest(1.0, 0.3)
at_least = [float(term.fn(z, y).sum() * 0.3 + ((z - x) ** 2).sum() / 2) for z in (right, right + 0.01, right - 0.01)]
alone, among = float(term.fn(x, y)[0]), [float(value) for value in term.fn(torch.cat([x, x]), torch.cat([y, y]))]
squares = L2(sigma=0.5).d
print("deepinv", deepinv.__version__, "gain: gradient over autograd's", ratio)
print("gain: prox, where the sum is least", lost, "value alone", round(alone, 3), "in a batch of two", [round(one, 3) for one in among])
assert torch.allclose(squares.grad(x, y), slope_of(squares)), "the term of squares has changed"
assert all(abs(value - gain**2) < 1e-3 for gain, pair in ratio.items() for value in pair), "gradient: the behaviour has changed"
assert at_least[0] < min(at_least[1:]), "our own formula is wrong: nothing can be said of what has changed"
assert all(found < 0 < least for found, least in lost.values()), "prox: the behaviour has changed"
assert min(abs(value - alone) for value in among) > 1, "batches: the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: prox(x, tau) of ProxTorch's operators is where tau times their function plus half the squared distance from x is least, and leaves
# x as it was. Found: FusedLasso, the total variation of a signal, moves the whole signal by its first step: 0, 10, 10, 10 becomes -9.5, 0, 0, 0,
# where 0.5 and three times 9.83 are right. Huber is off between its delta and delta (1 + tau alpha), 0.5 for 0.75, and writes
# its result into x. L1 is right, as are its other norms and the total variation of pictures.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check proxtorch==0.0.9 torch==2.13.0 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
from importlib.metadata import version

import torch
from proxtorch.operators import L1, FusedLasso, Huber

torch.set_default_dtype(torch.float64)


def total(operator, result, x):
    """Return what the proximal operator makes least, for tau = 1."""
    return float(operator._nonsmooth(result) + 0.5 * ((result - x) ** 2).sum())


found = {}
step, better = torch.tensor([0.0, 10, 10, 10]), torch.tensor([0.5, 10 - 1 / 6, 10 - 1 / 6, 10 - 1 / 6])
for name, operator, x, other in (
    ("L1", L1(0.5), step, torch.tensor([0, 9.5, 9.5, 9.5])),
    ("FusedLasso", FusedLasso(0.5), step, better),
    ("Huber", Huber(1.0, 1.0), torch.tensor([0.5, 1.5, 3]), torch.tensor([0.25, 0.75, 2])),
):
    given = x.clone()
    result = operator.prox(given, 1.0).clone()
    found[name] = result.tolist(), total(operator, result, x) - total(operator, other, x), torch.equal(given, x)
    print("proxtorch", version("proxtorch"), name, x.tolist(), "becomes", found[name][0], f"; {other.numpy().round(2).tolist()} is lower by {found[name][1]:.4g}; x is", given.tolist())
assert abs(found["L1"][1]) < 1e-9
assert found["FusedLasso"][0] == [-9.5, 0, 0, 0] and found["FusedLasso"][1] > 100, "FusedLasso: the behaviour has changed"
assert found["Huber"][0] == [0.25, 0.5, 2] and found["Huber"][1] > 0.05 and not found["Huber"][2], "Huber: the behaviour has changed"
PY

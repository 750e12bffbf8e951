#!/usr/bin/env bash
# A good guess: PyUNLocBoX's functions.norm_tv(lambda_=0.1) is a tenth of the total variation, as lambda_ of its norm_l1 and norm_l2 is their
# weight. Found: norm_tv takes lambda_, keeps it and uses it nowhere: its value and proximal operator are those of lambda_ = 1 for 0.01
# as for 10, so that a search for the best weight finds that it does not matter, and a restoration is smoothed as if by 1. Multiply the other
# terms instead. (Its proximal operator stops early, too: at its default tolerance it is 0.018 from where it goes to here.)
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check pyunlocbox==0.6.1 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from pyunlocbox import functions

square = np.zeros((32, 32))
square[8:24, 8:24] = 1
noisy = square + np.random.default_rng(0).normal(0, 0.1, square.shape)
found = {}
for weight in (0.01, 0.1, 1, 10):
    variation = functions.norm_tv(lambda_=weight, dim=2, verbosity="NONE", maxit=500, tol=1e-7)
    absolute = functions.norm_l1(lambda_=weight, verbosity="NONE")
    found[weight] = float(variation.eval(noisy)), float(np.std(variation.prox(noisy, 0.1) - noisy)), float(absolute.eval(noisy))
    print(f"PyUNLocBoX {version('pyunlocbox')} lambda_ {weight}: norm_tv {found[weight][0]:.2f}, what its prox changes {found[weight][1]:.4f}; norm_l1 {found[weight][2]:.2f}")
default = functions.norm_tv(dim=2, verbosity="NONE").prox(noisy, 0.1)
settled = functions.norm_tv(dim=2, verbosity="NONE", maxit=5000, tol=1e-12).prox(noisy, 0.1)
early = float(np.abs(default - settled).max())
print(f"the default's largest distance from where it settles {early:.4f}")
assert len({value[:2] for value in found.values()}) == 1, "norm_tv: the behaviour has changed"
assert np.isclose(found[10][2], 1000 * found[0.01][2]), "norm_l1 has no weight"
assert early > 0.005, "the default's end: the behaviour has changed"
PY

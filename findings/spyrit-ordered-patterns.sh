#!/usr/bin/env bash
# A good guess: SPyRiT's single-pixel camera (HadamSplit2d) simulates the readings of the patterns that it says it shows, y = A x, in whatever order of
# patterns it is given. Found: with an order, and with fast=True, the default, it does not: the differences of positive and negative
# patterns are right, their sums are not. It adds the coefficient that comes first, which is the whole light without an order
# alone. Of a scene without a dark place it reads -6 where its pattern lets 0 through; with fast=False it is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check --no-deps spyrit==3.1.1
v/bin/pip install --quiet --disable-pip-version-check torch==2.14.1 torchvision==0.29.1 ptwt==1.0.1 scipy==1.17.1 matplotlib==3.11.2
v/bin/pip install --quiet --disable-pip-version-check tqdm==4.70.1 imageio==2.38.1 requests==2.34.2 girder-client==3.2.15 pandas==3.1.1 scikit-image==0.26.0 numpy==2.4.6
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import torch
from spyrit.core.meas import HadamSplit2d

scene = torch.full((4, 4), 0.5)
scene[:, :2] = 1
order = torch.arange(16.0).reshape(4, 4)  # the greatest first: the patterns from the last to the first
errors, least = {}, {}
for name, settings in {"as they are": {}, "ordered": {"order": order}, "ordered, not fast": {"order": order, "fast": False}}.items():
    camera = HadamSplit2d(4, **settings)
    readings = camera.measure(scene)
    errors[name] = float((readings - scene.flatten() @ camera.A.T).abs().max())
    least[name] = float(readings.min())
    print("spyrit", version("spyrit"), name, "off by up to", round(errors[name], 3), "least reading", round(least[name], 3))
assert errors["as they are"] < 1e-5 and errors["ordered, not fast"] < 1e-5, "the behaviour has changed"
assert abs(errors["ordered"] - 6) < 1e-4 and abs(least["ordered"] + 6) < 1e-4, "the behaviour has changed"
PY

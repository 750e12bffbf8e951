#!/usr/bin/env bash
# A good guess: useq-schema's plans of stacks visit what their pages promise: the top is "always encompassed", also where the step does not divide
# the way; and random points in an ellipse are as likely in each of its parts. Found: from 0 to 10 in steps of 3 or 4 a stack ends at 9 or 8,
# while num_positions() counts the plane above; steps of 3.5 go past the top. Of random points 46 per cent lie in the middle quarter
# of the ellipse's area and 47 within a twentieth of its width from an axis (25 and 24 if all places were alike).
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check useq-schema==0.9.2 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import useq

print("useq-schema", version("useq-schema"))
visited = {}
for step in (2.5, 3, 3.5, 4):
    plan = useq.ZTopBottom(bottom=0, top=10, step=step)
    visited[step] = list(plan)
    print(f"from 0 to 10 by {step}: visits", visited[step], "counts", plan.num_positions())
    assert (len(visited[step]) == plan.num_positions()) == (step in (2.5, 3.5)), "counts: the behaviour has changed"
assert [planes[-1] for planes in visited.values()] == [10, 9, 10.5, 8], "stacks: the behaviour has changed"

points = useq.RandomPoints(num_points=20000, max_width=2, max_height=2, random_seed=1, order=None)
places = np.array([(point.x, point.y) for point in points])
middle = np.mean(np.hypot(*places.T) < 0.5)
near = np.mean(np.abs(places).min(axis=1) < 0.1)
grid = np.stack(np.meshgrid(*2 * [np.linspace(-1, 1, 1001)]), -1).reshape(-1, 2)
grid = grid[np.hypot(*grid.T) <= 1]
alike = np.mean(np.hypot(*grid.T) < 0.5), np.mean(np.abs(grid).min(axis=1) < 0.1)
print(f"random points in a circle: {middle:.3f} within half its radius ({alike[0]:.3f} if all places were alike), ", end="")
print(f"{near:.3f} near an axis ({alike[1]:.3f})")
assert places.shape == (20000, 2) and 0.44 < middle < 0.48 and 0.45 < near < 0.49, "points: the behaviour has changed"
PY

#!/usr/bin/env bash
# A good guess: fastquat's slerp goes from the first turn at 0 to the second at 1, however near they are, and each rotation matrix has a quaternion.
# Found: between turns less than 3.6 degrees apart it goes a quarter of the way and back, 0, 0.19, 0.25, 0.19 and 0 for 0 to 1 degree: the frames
# of a film or the steps of a stage are such neighbours. Matrices of half turns, diag(1, -1, -1) between camera conventions among them,
# become NaN without a word. In single precision, which JAX has unless told, turns below 0.03 degrees have a logarithm of 0.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check fastquat==0.5.2 jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
from importlib.metadata import version

import jax.numpy as jnp
import numpy as np
from fastquat import Quaternion


def about_z(degrees):
    """Return the quaternion of a turn about z."""
    half = jnp.float32(np.radians(degrees) / 2)
    return Quaternion(jnp.cos(half), 0.0, 0.0, jnp.sin(half))


def angle(quaternion):
    """Return degrees about z."""
    return round(float(np.degrees(2 * np.arctan2(quaternion.z, quaternion.w))), 3)


parts = (0, 0.25, 0.5, 0.75, 1)
for degrees in (1, 3, 3.5, 4, 40):
    way = [angle(about_z(0).slerp(about_z(degrees), jnp.float32(part))) for part in parts]
    print("fastquat", version("fastquat"), f"from 0 to {degrees} degrees:", way)
    expected = [degrees * (part * (1 - part) if degrees < 3.6 else part) for part in parts]
    assert np.allclose(way, expected, atol=0.01), "slerp: the behaviour has changed"

for diagonal in ([1, 1, 1], [1, -1, -1], [-1, -1, 1]):
    found = np.asarray(Quaternion.from_rotation_matrix(jnp.diag(jnp.float32(np.array(diagonal)))).wxyz)
    print(f"the matrix diag{tuple(diagonal)}:", found)
    assert np.isnan(found).any() == (diagonal != [1, 1, 1]), "half turns: the behaviour has changed"

logarithms = {degrees: float(np.degrees(2 * about_z(degrees).log().z)) for degrees in (0.02, 1)}
print("angles of logarithms:", logarithms)
assert logarithms[0.02] == 0 and np.isclose(logarithms[1], 1, atol=0.01), "logarithms: the behaviour has changed"
PY

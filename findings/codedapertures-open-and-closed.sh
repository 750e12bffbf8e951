#!/usr/bin/env bash
# A good guess: codedapertures makes masks with the share of open elements that it is told, its "fill factor", a Fresnel zone plate that lets light through
# between none and all and whose practical form is open by half, and the decoder that makes a point of a modified uniformly redundant array.
# Found: of a factor of 0.2 four fifths are open. The zone plate lets -1 to 1 through, its practical form a third, and `density` says
# of both that all is closed. And the decoder lacks the array's exception for its first element: half of the places beside the point are -2.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check codedapertures==0.12 numpy==2.4.6
MPLBACKEND=agg v/bin/python - <<'PY'
from importlib.metadata import version

import codedapertures
import numpy as np

print("codedapertures", version("codedapertures"))
assert "fill factor" in codedapertures.randa2d.__doc__, "the behaviour has changed"
np.random.seed(0)
share = codedapertures.randa2d(100, 100, density=0.2, quiet=True).aperture.mean()
plates = [codedapertures.fzp(radius=4, resolution=20, transmission=kind, quiet=True) for kind in ("theoretical", "practical")]
print(f"open of a fill factor of 0.2: {share:.3f}; a zone plate lets {plates[0].aperture.min():.2f} to {plates[0].aperture.max():.2f} through,")
print(f"its practical form is open by {plates[1].aperture.mean():.3f}, with densities of {[plate.density for plate in plates]}")
assert abs(share - 0.8) < 0.02 and plates[0].aperture.min() < -0.99, "shares: the behaviour has changed"
assert abs(plates[1].aperture.mean() - 1 / 3) < 0.01 and [plate.density for plate in plates] == [1, 1], "plates: the behaviour has changed"


def decoded(array, decoder):
    """Return the periodic correlation of an array with its decoder: a point where it is right."""
    return np.fft.ifft2(np.fft.fft2(array) * np.conj(np.fft.fft2(decoder))).real.round(6)


for rank in (1, 3):
    mask = codedapertures.mura(rank=rank, quiet=True)
    mask.gen_decoder("balanced")
    point = decoded(mask.aperture, mask.decoder)
    mask.decoder[0, 0] = 1
    right = decoded(mask.aperture, mask.decoder)
    beside, places = np.unique(point.ravel()[1:], return_counts=True)
    print(f"L = {mask.L}: the point is {point[0, 0]:.0f}, beside it are", dict(zip(beside.tolist(), places.tolist(), strict=True)), end=" ")
    print("and with the exception", np.unique(right.ravel()[1:]))
    assert beside.tolist() == [-2, 0] and not right.ravel()[1:].any(), "decoders: the behaviour has changed"
PY

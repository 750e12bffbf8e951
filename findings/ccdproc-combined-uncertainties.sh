#!/usr/bin/env bash
# A good guess: the uncertainty of frames that ccdproc's Combiner combines is how much the result scatters: from the frames' own uncertainties if they
# have them, with the weights that it was given. Found: it always takes the scatter of the frames over n, never their uncertainties, and leaves out
# the weights: of nine frames of +- 5 weighted by 1 to 9 the sum scatters by 84 and says 14. Nor does it correct for few frames: the mean of two
# scatters by 3.5 and says 2.0; the median of nine scatters by 2.0 and says 1.5. A masked pixel leaves a sum short by its frame: 300 of 400.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check ccdproc==2.5.1 astropy==8.0.2 numpy==2.4.6
v/bin/python -W ignore - <<'PY'
import ccdproc
import numpy as np
from astropy.nddata import CCDData, StdDevUncertainty

random = np.random.default_rng(0)


def frames(count):
    own = StdDevUncertainty(np.full((150, 150), 5.0))
    return [CCDData(random.normal(100, 5, (150, 150)), unit="adu", uncertainty=own) for _ in range(count)]


def scatter_and_claim(combined):
    return round(float(combined.data.std()), 2), round(float(np.mean(combined.uncertainty.array)), 2)


nine = ccdproc.Combiner(frames(9))
found = {"mean of two": scatter_and_claim(ccdproc.Combiner(frames(2)).average_combine()), "median of nine": scatter_and_claim(nine.median_combine())}
nine.weights = np.arange(1.0, 10.0)
found["weighted sum of nine"] = scatter_and_claim(nine.sum_combine())
alike = [CCDData(np.full((40, 40), 100.0), unit="adu", uncertainty=StdDevUncertainty(np.full((40, 40), 5.0))) for _ in range(4)]
own = float(np.max(ccdproc.Combiner(alike).average_combine().uncertainty.array))
alike[0].mask = np.eye(40, dtype=bool)
total = ccdproc.Combiner(alike).sum_combine()
short = float(total.data[3, 3]), bool(total.mask[3, 3])
print("ccdproc", ccdproc.__version__, "scatters, says", found, "of equal frames of +- 5", own, "sum at a masked pixel, masked", short)
assert found["weighted sum of nine"][0] > 5 * found["weighted sum of nine"][1], "weights: the behaviour has changed"
assert 1.6 < found["mean of two"][0] / found["mean of two"][1] < 1.9, "two frames: the behaviour has changed"
assert found["median of nine"][0] > 1.25 * found["median of nine"][1], "the median: the behaviour has changed"
assert own == 0, "the frames' own uncertainties: the behaviour has changed"
assert short == (300, False), "a masked pixel: the behaviour has changed"
PY

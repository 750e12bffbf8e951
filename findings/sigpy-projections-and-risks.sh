#!/usr/bin/env bash
# A good guess: sigpy's psd_proj() gives the nearest positive semi-definite matrix, monte_carlo_sure() estimates the error of a denoiser for single
# precision, too, which a camera's pictures have, l1_proj() keeps an array's shape, and a wavelet's H is its adjoint. Found: where eigenvalues coincide
# psd_proj() is off by 1 and more: its eigenvectors are not at right angles. In single precision the step of 1e-10 is lost, and risks are too small by
# up to twice the noise's variance, and negative. A matrix within the l1 ball becomes a vector. H of biorthogonal wavelets, as of JPEG 2000, is the inverse.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check sigpy==0.1.27 PyWavelets==1.9.0 scipy==1.17.1 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python -W ignore - <<'PY'
import numpy as np
import sigpy

rng = np.random.default_rng(0)
off = {}
for values in ((3, 2, 1, -1), (2, 2, 2, -1)):
    off[values] = 0
    for _ in range(20):
        axes = np.linalg.qr(rng.normal(size=(4, 4)))[0]
        right = axes * np.maximum(values, 0) @ axes.T
        off[values] = max(off[values], abs(sigpy.thresh.psd_proj(axes * np.array(values, float) @ axes.T) - right).max())
    print("sigpy", sigpy.__version__, f"psd_proj of eigenvalues {values} is off by up to {off[values]:.2g}")
clean = np.zeros((64, 64))
clean[16:48, 16:48] = 1
noisy = clean + rng.normal(0, 0.1, clean.shape)
risk = {}
for name, denoise in (("nothing", lambda y: y), ("a soft threshold of 0.1", lambda y: sigpy.soft_thresh(0.1, y))):
    for kind in (np.float64, np.float32):
        y = noisy.astype(kind)
        risk[name, kind] = float(sigpy.util.monte_carlo_sure(denoise, y, 0.1)), float(((denoise(y) - clean) ** 2).mean())
        print(f"the risk of {name} in {kind.__name__}: {risk[name, kind][0]:.4f}, its error {risk[name, kind][1]:.4f}")
array = rng.normal(size=(3, 4))
shapes = [sigpy.thresh.l1_proj(size, array).shape for size in (1, 1000)]
print("l1_proj of a matrix outside and inside the ball:", *shapes)
adjoint = {}
for wavelet in ("db4", "bior4.4"):
    operator = sigpy.linop.Wavelet((64, 64), wave_name=wavelet)
    x, y = rng.normal(size=operator.ishape), rng.normal(size=operator.oshape)
    adjoint[wavelet] = abs(np.vdot(operator(x), y) - np.vdot(x, operator.H(y))) / abs(np.vdot(operator(x), y))
    print(wavelet, f"products with an operator and with its H differ by {adjoint[wavelet]:.2g} of them")
assert off[3, 2, 1, -1] < 1e-8 and adjoint["db4"] < 1e-8 and shapes[0] == (3, 4)
assert all(abs(found - error) < 1e-3 for (_, kind), (found, error) in risk.items() if kind is np.float64)
assert off[2, 2, 2, -1] > 0.5, "psd_proj: the behaviour has changed"
assert all(found < 0 < error for (_, kind), (found, error) in risk.items() if kind is np.float32), "monte_carlo_sure: the behaviour has changed"
assert shapes[1] == (12,), "l1_proj: the behaviour has changed"
assert adjoint["bior4.4"] > 0.01, "wavelets: the behaviour has changed"
PY

"""One Gaussian replaced by several in the same place that together look the same along a ray.

Here: the arithmetic of the relocations of 3DGS-MCMC (Kheradmand et al. 2024, "3D Gaussian splatting as Markov chain
Monte Carlo", section 4.3 and appendix B), in a form that holds for any number of copies. Not here: which Gaussians are
replaced (`mcmc.py`).

N copies of opacity p = 1 − (1 − α)^(1/N) together transmit as much as one of opacity α. Their size is chosen so that
the light stopped, summed along a line through the centre, is preserved as well: with s in units of √2 standard
deviations,

    σ_N / σ = α ∫ exp(−s²) ds / ∫ 1 − (1 − p exp(−s²))^N ds.

Expanded in powers of p, the lower integral is the double sum of binomials that the authors give. Its terms alternate in
sign and reach e^(Np), and its binomials exceed float32 near N = 50, where the authors end the sum. In the integral all
terms are positive. The integrand is smooth and decays with exp(−s²), so that the trapezoid rule converges exponentially
in the number of nodes.
"""

import math
from typing import Final

import torch
from torch import Tensor

_STEP: Final = 0.05
_REACH: Final = 7.0  # exp(−s²) is 5e-22 there: for Np < 100 the integrand is below the resolution of float64
_NODES: Final = round(_REACH / _STEP) + 1
_OPACITY_KNOWN: Final = 1e-200
"""Below this the limit of small opacities holds to the last digit: p = α / N, and the size stays."""


def share_out(opacity_logits: Tensor, log_scales: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """Return opacity logits [K] and log scales [K, 3] of the copies that together look like the original.

    Args:
        opacity_logits: Of the originals, [K].
        log_scales: Of the originals, [K, 3].
        copies: How many replace each, [K], at least 1; 1 changes nothing.
    """
    n = copies.double()
    logits = opacity_logits.double()
    log_through = torch.nn.functional.logsigmoid(-logits)  # ln(1 − α), exact where α is near 0 or 1
    log_rest = log_through / n  # ln(1 − p)
    opacity, part = -torch.expm1(log_through), -torch.expm1(log_rest)
    known = (n > 1) & (opacity > _OPACITY_KNOWN)
    share = torch.where(known, torch.log(torch.where(known, part, 1.0)) - log_rest, logits - torch.log(n))
    stopped = _light_stopped(torch.where(known, part, 0.5), n)
    shrink = torch.where(known, torch.log(0.5 * math.sqrt(math.pi) * opacity / stopped), 0.0)
    return share.to(opacity_logits.dtype), (log_scales.double() + shrink[:, None]).to(log_scales.dtype)


def most_copies(opacity_logits: Tensor, opacity: float) -> Tensor:
    """Return how many copies [K] may replace Gaussians so that no copy is fainter than `opacity`; at least 1."""
    log_through = torch.nn.functional.logsigmoid(-opacity_logits.double())
    # Slightly more, so that the quotient of an opacity by itself does not round to 0.999...
    return (log_through / math.log1p(-opacity) * (1 + 1e-9)).floor().clamp(min=1).long()


def _light_stopped(part: Tensor, n: Tensor) -> Tensor:
    """Return the integral over s >= 0 of 1 − (1 − p exp(−s²))^n for p and n, [K] each."""
    s = _STEP * torch.arange(_NODES, dtype=torch.float64)
    weight = torch.full((_NODES,), _STEP, dtype=torch.float64)
    weight[0] *= 0.5
    # If p rounds to one, the logarithm at s = 0 is −∞ and the integrand is one, which is right.
    return -torch.expm1(n[:, None] * torch.log1p(-part[:, None] * torch.exp(-s * s))) @ weight

"""A denoiser for plug-and-play decoding by groups of similar patches from all views.

Here: which groups are used when, and colour. Not here: the search for them (`matching`), the denoising of a group
(`low_rank`), the schedule (`decoder`).
"""

from typing import Final

import numpy as np
import torch

from gs2ci.core.arrays import F32, I32, Size
from gs2ci.reconstruct.decode.patches.flow import Flow
from gs2ci.reconstruct.decode.patches.low_rank import denoise_groups, patches_over
from gs2ci.reconstruct.decode.patches.matching import Lattice, find_groups
from gs2ci.render.places import working_device

# Groups of similar patches denoised on a device, in torch: what `low_rank.py` does, to rounding.
#
# Eigenvectors are cuSOLVER's, which takes matrices of up to 32 x 32 all at once and larger ones one after the other:
# groups of more patches stay on the host. Denoised patches are added up as integers, whose sum has no order: the same
# bits from run to run. Never run on a GPU so far.
#
# Not here: why groups are shrunk so (`low_rank.py`), where their patches lie (`matching`).

MOST_PATCHES: Final = 32
"""Of a group that is denoised here."""
PER_UNIT: Final = 2**30
"""Integers per unit of a view's full scale, in sums."""
_LARGEST: Final = 2.0**15
# Groups at once: some 300 MB with 32 coloured patches each.
_AT_ONCE: Final = 4096


def denoise_groups_on_device(
    planes: F32, corners: I32, patch: Size, sigma: float, fallback: F32, device: torch.device
) -> F32:
    """Denoise planes together by groups of fewer similar patches than a patch has pixels.

    Arguments and result are those of `low_rank.denoise_groups`, and where.
    """
    (colours, views, height, width), members = planes.shape, corners.shape[1]
    given, instead, numbers = (
        torch.from_numpy(one).to(device) for one in (planes, fallback, patches_over(corners, patch, planes.shape[1:]))
    )
    if not given.isfinite().all():  # no eigenvectors are found there, and none of the integers would show it
        return np.full_like(planes, np.nan)
    first = np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), (views, height, width))
    of_patch = np.ravel_multi_index(np.indices((colours, 1, *patch)).reshape(4, -1).tolist(), planes.shape)
    inside = torch.from_numpy(of_patch).to(device)
    noise, threshold = members * colours * sigma**2, (members * colours) ** 0.5 * sigma**2
    sums = torch.zeros(planes.size, dtype=torch.int64, device=device)
    for start in range(0, len(first), _AT_ONCE):
        places = torch.from_numpy(first[start : start + _AT_ONCE]).to(device)[..., None] + inside
        patches = given.view(-1)[places]
        mean = patches.mean(dim=1, keepdim=True)
        centred = patches - mean
        values, vectors = torch.linalg.eigh(centred @ centred.mT)
        signal = ((values - noise).clamp(min=0) * values.clamp(min=0)).sqrt()
        weights = (1 - threshold / signal).clamp(min=0)
        restored = (vectors * weights[:, None]) @ (vectors.mT @ centred) + mean
        sums.index_add_(0, places.flatten(), (restored.clamp(-_LARGEST, _LARGEST) * PER_UNIT).long().flatten())
    denoised = (sums.view(planes.shape).double() / PER_UNIT / numbers.clamp(min=1)).float()
    return torch.where(numbers > 0, denoised, instead).cpu().numpy()


# Orthonormal: white noise stays white and of the same strength. The first row is the mean, in which motion is found and
# patches are compared (a decomposition would leave its sign open, and no flow is found in a picture that is negative);
# in the other rows pictures vary little, so that noise is easier to separate.
_OPPONENT: Final = (np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])).astype(np.float32)

# How far a pixel without a patch may lag behind the given views, in standard deviations of their noise: so far their
# noise alone goes.
_MOST_LAG: Final = 3.0


class SimilarPatches:
    """Denoises a stack of views by the common part of similar patches from all views.

    Args:
        start: Views in which similar patches are first searched for, [N, C, H, W]; later the last denoised views.
        lattice: Of the reference patches.
        refind_every: After so many uses of a phase of the lattice, its groups are searched for again.

    Each call uses the next phase of the lattice: over the calls of a decoder every position is the reference of some
    group, at a fraction of the cost.
    """

    def __init__(self, start: F32, lattice: Lattice, refind_every: int) -> None:
        self._last, self._lattice, self._refind_every = start, lattice, refind_every
        self._groups: dict[int, np.ndarray] = {}
        self._calls = 0

    def seeks(self, call: int) -> bool:
        """Tell whether a call, counted from 0, searches for its groups instead of using those of an earlier call."""
        return call // self._lattice.parts(len(self._last)) % self._refind_every == 0

    def __call__(self, views: F32, sigma: float) -> F32:
        """Denoise, [N, C, H, W]; arguments as for `Denoiser`."""
        parts = self._lattice.parts(len(views))
        phase, seeks = self._calls % parts, self.seeks(self._calls)
        self._calls += 1
        given, before = _mixed(_OPPONENT, views), _mixed(_OPPONENT, self._last)
        if seeks:
            # Scaled so that white is 1 in a grey and in a coloured picture.
            guide = np.ascontiguousarray(before[:, 0]) / np.float32(np.sqrt(views.shape[1]))
            self._groups[phase] = find_groups(guide, Flow.between(guide), self._lattice, phase)
        patch = self._lattice.patch((views.shape[2], views.shape[3]))
        fallback = _within_noise(before, given, sigma)
        planes, without_patch = (np.ascontiguousarray(one.swapaxes(0, 1)) for one in (given, fallback))
        smooth = _denoise(planes, self._groups[phase], patch, sigma, without_patch).swapaxes(0, 1)
        denoised = _mixed(_OPPONENT.T, smooth)
        self._last = denoised.copy()
        return denoised


def _denoise(planes: F32, corners: I32, patch: Size, sigma: float, fallback: F32) -> F32:
    """Denoise planes, [C, N, H, W], by the same groups, where such work is to be done (`places`)."""
    device, members = working_device(), corners.shape[1]
    if device is None or members > MOST_PATCHES or members >= patch[0] * patch[1]:
        return denoise_groups(planes, corners, patch, sigma, fallback)
    return denoise_groups_on_device(planes, corners, patch, sigma, fallback, device)


def _within_noise(before: F32, views: F32, sigma: float) -> F32:
    """Return the last denoised values, as far as they differ from the given views by no more than noise.

    A pixel keeps its last value while no group contains it, and accelerated GAP adds its residual to the measurement
    each time. The next group that contains the pixel would return all of the sum at once: in a pixel that only one mask
    opens, used by one call of four, the error grew by a factor of three each time, and left float32 in one decode.
    """
    most = np.float32(_MOST_LAG * sigma)
    return views + np.clip(before - views, -most, most)


def _mixed(matrix: F32, views: F32) -> F32:
    """Mix the colours of views, [N, C, H, W], if there are several."""
    return views if views.shape[1] == 1 else np.einsum("dc,nchw->ndhw", matrix, views)

"""Groups of similar patches denoised on a device, in torch: what `low_rank.py` does, to rounding.

Eigenvectors are cuSOLVER's, which takes matrices of up to 32 x 32 all at once and larger ones one after the other:
groups of more patches stay on the host. Denoised patches are added up as integers, whose sum has no order: the same
bits from run to run. Never run on a GPU so far.

Not here: why groups are shrunk so (`low_rank.py`), where their patches lie (`matching`).
"""

from typing import Final

import numpy as np
import torch

from gs2ci.core.arrays import F32, I32, Size
from gs2ci.reconstruct.decode.patches.low_rank import patches_over

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
    found: F32 = torch.where(numbers > 0, denoised, instead).cpu().numpy()
    return found

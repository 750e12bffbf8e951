"""Where a reconstruction renders, and how much memory of a CUDA device it takes: known before anything is computed.

Not here: the choice among devices (`gs2ci.render.devices`), the rendering (`gs2ci.render.warp`).
"""

import math
from dataclasses import replace
from typing import Final

from gs2ci.core.records import Shot
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.devices import CudaProbe, RenderingPlace, place

# Bytes of the renderer's arrays: of an open pixel (its place, output, weight, block, and what was blended there), of a
# pixel of an output, of a Gaussian in a view (its record, box, depth, count, and its part of the poses' gradients), and
# of a Gaussian in the list of a block (sort keys and rows twice, owner, sums of gradients).
_SLOT_BYTES: Final = 44
_OUTPUT_BYTES: Final = 36
_PAIR_BYTES: Final = 128
_ENTRY_BYTES: Final = 64
# Blocks of pixels that a Gaussian of a view touches in the mean: 14 at most in a draft of 48 × 64 px, in whole views;
# in coded sums, whose blocks are larger, 8.
_BLOCKS: Final = 16
# Of a fit: parameters, gradients, moments and passing copies of a Gaussian; pictures of the loss; costs of a sweep.
_GAUSSIAN_BYTES: Final = 14 * 4 * 8
_PICTURES: Final = 40
_SWEPT_COPIES: Final = 5
# CUDA itself, the kernels' code, and what allocation leaves unused.
_CONTEXT_MIB: Final = 512
_SPARE: Final = 1.25


def placed(
    shot: Shot, settings: Settings, probe: CudaProbe | None = None, exposures: int = 1
) -> tuple[Settings, RenderingPlace]:
    """Choose the device that the settings leave open, and return the settings with its renderer.

    Settings whose backend is not the CPU's keep it: their caller has chosen.

    Args:
        shot: The measurement, or the first of several.
        settings: Of the reconstruction.
        probe: What is asked of the computer; None: this one.
        exposures: How many one scene is fitted to; each has masks of its own.

    Raises:
        InputError: The settings name a CUDA device that cannot be used.
        ResourceError: It has too little memory.
    """
    if settings.backend != "cpu":
        return settings, RenderingPlace(settings.backend, settings.backend)
    placement = place(settings.device, exposures * needed_mib(shot, settings), probe)
    return replace(settings, backend=placement.backend), placement


def needed_mib(shot: Shot, settings: Settings) -> int:
    """Estimate the memory of a CUDA device that a reconstruction takes, from the shot's size and the largest fit.

    A mask that gets several moments counts as one; what that adds is within the spare.
    """
    views, pixels = shot.views, shot.size[0] * shot.size[1]
    of_pixels = settings.fit.gaussians_per_pixel
    most = settings.fit.most_gaussians if of_pixels is None else int(of_pixels * pixels)
    gaussians = max(most or 0, math.ceil(pixels / settings.stride_px**2))
    whole, coded = views * pixels, float((shot.masks > 0).sum())
    pairs = views * gaussians
    # Those of a view that is looked at, beside those of the coded sum, whose memory a fit keeps.
    lists = pairs * (2 * _PAIR_BYTES + _ENTRY_BYTES * (_BLOCKS + _BLOCKS // 2))
    rendering = (whole + coded) * _SLOT_BYTES + (whole + pixels) * _OUTPUT_BYTES + lists
    surfaces = settings.fit.surfaces
    swept = 0 if surfaces is None else min(pixels, surfaces.sweep.most_pixels) * surfaces.sweep.planes
    fit = gaussians * _GAUSSIAN_BYTES + 4 * (_PICTURES * 3 * pixels + _SWEPT_COPIES * swept)
    total = rendering + fit
    return _CONTEXT_MIB + math.ceil(_SPARE * total / 2**20)

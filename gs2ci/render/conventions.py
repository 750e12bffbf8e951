"""The image model's constants, each once and with its reason.

The model is the usual one of 3D Gaussian splatting (Kerbl et al. 2023): a Gaussian is projected by the affine
approximation of the camera at its centre (EWA, Zwicker et al. 2001), drawn as a 2D Gaussian and blended front to back.
The float64 definition (`tests/render/reference.py`) and every fast path read the same numbers from here.
"""

from typing import Final

NEAR: Final = 0.01
"""Gaussians whose centre is not deeper than this (scene units) are not drawn: 1/z would blow up below it."""

DILATION_PX2: Final = 0.3
"""Added to both variances of a projected Gaussian: the box filter of a pixel, and what keeps needles and points
wide enough to receive a gradient."""

ALPHA_MIN: Final = 1.0 / 255.0
"""Smaller alphas are not blended: they bound each Gaussian's footprint, and no 8-bit image could show them."""

ALPHA_MAX: Final = 0.999
"""Larger alphas are cut to this, with zero gradient: transmittance stays positive, so that 1 / (1 - alpha) in the
gradient stays below 1000."""

FRUSTUM_MARGIN: Final = 0.15
"""The slope at which the camera is linearised is clamped to the frame plus this share of its width on each side:
far off the axis the affine approximation would smear a Gaussian across the whole image."""

SCREEN_SIGMA_MAX_PX: Final = 1e8
"""A Gaussian wider than this on screen is not drawn: the squares of its moments leave float32. It takes a scale
of 10^3 at the near plane of a 1000 px lens to get there."""

LOG_SCALE_MAX: Final = 18.0
"""Log scales are cut here (6.6e7 scene units): their exponentials stay far inside float32."""

QUATERNION_NORM_MIN: Final = 1e-12
"""A shorter quaternion names no rotation; it is read as the identity and receives no gradient."""

SIGHT_MIN: Final = 1e-12
"""A line of sight shorter than this (scene units) has no direction: colours that change with it are seen as their
constant part. What is so near is not drawn."""

TERMINATION_TRANSMITTANCE: Final = 1e-4
"""A fast path may stop blending a group of pixels once all of them let less light through than this. It changes
a pixel by at most this share of the colour behind it. The definition never stops."""

"""Motion blur: the camera moves while a mask is on show, so each interval is a sum over moments."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Stage

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class MotionBlur:
    """Split every exposed slice of time into equal parts, each of which is rendered at its middle.

    The midpoint rule for ∫ L(x, t) dt; it keeps the total time, hence the energy, exactly. Off, a slice is one
    moment.

    Args:
        samples: Parts per slice, at least 1. `gs2ci_sims.planner.motion_samples` chooses.
    """

    name: ClassVar[str] = "motion_blur"
    stage: ClassVar[Stage] = Stage.EXPOSURE

    samples: int

    def __post_init__(self) -> None:
        if self.samples < 1:
            raise InputError(f"motion blur with {self.samples} samples", allowed="1 or more")

    def apply(self, signal: F64, rng: np.random.Generator) -> F64:
        """Split [N, S, 2] into [N, S * samples, 2]."""
        start, stop = signal[..., :1], signal[..., 1:]
        edges = start + (stop - start) * np.linspace(0, 1, self.samples + 1)
        parts = np.stack([edges[..., :-1], edges[..., 1:]], axis=-1)
        return parts.reshape(len(signal), -1, 2)

"""Motion blur: the camera moves while a mask is on show, so each interval is a sum over moments."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, Stage
from gs2ci_sims.signals import Slices

if TYPE_CHECKING:
    from gs2ci_sims.preview import Preview
    from gs2ci_sims.rig import Rig

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class MotionBlur:
    """Split every exposed slice of time into equal parts, each of which is rendered at its middle.

    The midpoint rule for ∫ L(x, t) dt; it keeps the total time, hence the energy, exactly. Off, a slice is one
    moment.

    Args:
        samples: Parts per slice, at least 1; the planner chooses.
    """

    name: ClassVar[str] = "motion_blur"
    stage: ClassVar[Stage] = Stage.TIME
    cost_ns: ClassVar[float] = 0.0
    fixed_pattern: ClassVar[bool] = False

    samples: int = 1

    def __post_init__(self) -> None:
        if self.samples < 1:
            raise InputError(f"motion blur with {self.samples} samples", allowed="1 or more")

    def bound(self, scene: "Preview", rig: "Rig") -> Bound:
        """One sample against infinitely many; see `sampling_bound`."""
        return self.sampling_bound(scene, rig, 1)

    def sampled(self, samples: int) -> "MotionBlur":
        """Return the same with so many parts per slice."""
        return replace(self, samples=samples)

    def sampling_bound(self, scene: "Preview", rig: "Rig", samples: int) -> Bound:
        """Bound the midpoint rule's error by the light that moves by more than nothing within a part.

        Within a part the image moves by at most δ = motion / samples / 2 from the middle, hence by no more than
        δ |∇L|; the parts' average of |t| halves that.
        """
        from gs2ci_sims.planner import image_motion_px  # noqa: PLC0415

        shift_px = image_motion_px(scene.scene, scene.path, scene.intervals_s) / (4 * samples)
        down, right = (np.gradient(scene.views, axis=axis) if scene.views.shape[axis] > 1 else 0.0 for axis in (1, 2))
        slope = np.sqrt(np.square(down) + np.square(right)).max(axis=0)
        change_dn = np.tensordot(shift_px, scene.masks, axes=1)[..., None] * slope * rig.full_scale_e * rig.dn_per_e
        return Bound(float(np.sqrt(np.square(change_dn).mean())), float(change_dn.max()))

    def apply(self, signal: Slices, rig: "Rig", rng: np.random.Generator) -> Slices:
        """Split S slices into S * samples."""
        edges = signal.start_s[:, None] + signal.duration_s[:, None] * np.linspace(0, 1, self.samples + 1)
        start, stop = edges[:, :-1].ravel(), edges[:, 1:].ravel()
        return Slices(
            start,
            stop,
            0.5 * (start + stop),
            signal.mix.repeat(self.samples, axis=0),
            None if signal.rows is None else signal.rows.repeat(self.samples, axis=0),
        )

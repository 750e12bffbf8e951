"""Adam over the parameters of a changing set of Gaussians.

Here: step sizes and their schedule, and the bookkeeping that keeps Adam's moments with their Gaussians when some are
added or removed. Not here: which are added or removed (`density/`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import torch
from torch import Tensor

from gs2ci.reconstruct.fit.optimiser.adam import DECAY, Adam
from gs2ci.reconstruct.fit.optimiser.poses import LengthUnit
from gs2ci.reconstruct.fit.optimiser.view_steps import ReferenceView, ViewAdam, ViewSteps
from gs2ci.render.gaussians import Gaussians, all_finite
from gs2ci.render.harmonics import SH_DC, coefficients, degree_of

# Adam's steps below are those of a schedule of so many iterations; a shorter schedule has to cover the same distance in
# fewer, longer steps. At 50 iterations three times the step gains 0.1 to 0.9 dB over twice the step, at 25 three and a
# half times the step gains as much again; longer steps were not tried.
NATURAL_ITERATIONS: Final = 600
LARGEST_STRIDE: Final = 3.5
_STRETCHED: Final = ("means", "log_scales", "quaternions", "opacity_logits", "colours", "motion_px", "harmonics")
# Parameters whose steps shrink along the schedule.
_SHRINKING: Final = ("means", "motion")


@dataclass(frozen=True)
class StepSizes:
    """Adam's step sizes per parameter; those of a schedule of `NATURAL_ITERATIONS`, unless others are given.

    Adam moves a parameter by at most its step in an iteration, so a schedule of 600 iterations instead of 30,000 needs
    longer steps: eighty times the literature's for positions, five to nine times for shapes, one and a half times for
    opacities and colours (docs/decisions/steps.md).

    Args:
        means: In `unit`, at the start. Not used where positions step in the coordinates of a view, but for the noise
            that a density rule adds.
        means_final_share: The share of it left at the end; exponential in between.
        in_view: Of positions in the coordinates of the reference view, if a camera path is known; None: they always
            step in scene coordinates, by `means`.
        unit: Of lengths: of the means' step, and of the sizes that density rules judge.
        motion_px: Of the rows of a moving scene's motion, in pixels at the median depth, with the same share left at
            the end. Not in units of the path: how far things move has nothing to do with how far the camera does.
        harmonics: Of the direction-dependent part of colours: a twentieth of the colours' step, both as coefficients of
            harmonics, as in Kerbl et al. (2023).
        momentum: By what Adam's mean gradient decays from iteration to iteration. The mean lags behind by
            1 / (1 − momentum) iterations, which is long beside a short schedule (docs/decisions/steps.md).
    """

    means: float = 1.28e-2
    log_scales: float = 2.25e-2
    quaternions: float = 9e-3
    opacity_logits: float = 7.5e-2
    colours: float = 3.75e-3
    means_final_share: float = 0.2
    unit: LengthUnit = "path diameter"
    motion_px: float = 0.2
    harmonics: float = 6.6e-4
    in_view: ViewSteps | None = field(default_factory=ViewSteps)
    momentum: float = DECAY

    @classmethod
    def of_schedule(cls, iterations: int) -> "StepSizes":
        """Return the steps of a schedule of so many iterations.

        They grow with the square root of the ratio of `NATURAL_ITERATIONS` to its length, up to `LARGEST_STRIDE`; as
        much fewer are the iterations by which the mean gradient lags behind.
        """
        stride = min(LARGEST_STRIDE, max(1.0, (NATURAL_ITERATIONS / iterations) ** 0.5))
        natural = cls()
        in_view = None if natural.in_view is None else natural.in_view.times(stride)
        longer = {name: getattr(natural, name) * stride for name in _STRETCHED}
        return replace(natural, in_view=in_view, momentum=1 - (1 - natural.momentum) * stride, **longer)

    @classmethod
    def of_the_literature(cls, unit: LengthUnit = "path diameter") -> "StepSizes":
        """Return the steps of a schedule of 30,000 iterations (Kerbl et al. 2023, appendix B).

        Their colour step is for coefficients of the constant harmonic; our colours are `SH_DC` times these.
        """
        return cls(
            unit=unit,
            means=1.6e-4,
            log_scales=5e-3,
            quaternions=1e-3,
            opacity_logits=5e-2,
            colours=2.5e-3 * SH_DC,
            means_final_share=0.01,
            motion_px=2.5e-3,
            harmonics=1.25e-4,
            in_view=None,
        )


class GaussianOptimiser:
    """Holds the Gaussians being fitted as leaf tensors, with one Adam over them.

    Args:
        scene: Where to start; copied.
        sizes: Step sizes.
        extent: Length that the means' step size is measured in, in scene units.
        view: The view in whose coordinates positions step, if the step sizes have any for that; None: they step in
            scene coordinates.
        px_per_length: A scene unit at the median depth in the picture, px; needed only for scenes that move.
    """

    def __init__(
        self,
        scene: Gaussians,
        sizes: StepSizes,
        extent: float,
        view: ReferenceView | None = None,
        px_per_length: float = 1.0,
    ) -> None:
        self._sizes = sizes
        self._extent = extent
        self._px_per_length = px_per_length
        self._view = view
        self.scene = _leaves(scene)
        self._begin()

    def _begin(self) -> None:
        """Begin with moments of zero."""
        self._adam = {name: Adam(decay=self._sizes.momentum) for name in self.scene.parameters()}
        self._in_view: ViewAdam | None = None
        if self._view is not None and self._sizes.in_view is not None:
            self._in_view = ViewAdam(self._view, self._sizes.in_view, self._adam["means"])

    def _initial_rate(self, name: str) -> float:
        if name == "motion":
            return self._sizes.motion_px / self._px_per_length
        rate = float(getattr(self._sizes, name))
        return rate * self._extent if name == "means" else rate

    def means_rate(self, progress: float, damping: float = 1.0) -> float:
        """Return the step size of the means, in scene units; arguments as for `step`."""
        return self._rate("means", progress) * damping

    def _rate(self, name: str, progress: float) -> float:
        decay = self._sizes.means_final_share**progress if name in _SHRINKING else 1.0
        return self._initial_rate(name) * decay

    def step(self, progress: float, damping: float = 1.0) -> None:
        """Step along the gradients and clear them.

        Args:
            progress: Share of the schedule that is done, in [0, 1].
            damping: Further factor on every step size.
        """
        scene = self.scene
        for name, tensor in scene.parameters().items():
            if name == "means" and self._in_view is not None:
                self._in_view.step(scene.means, scene.log_scales, progress, damping)
            else:
                self._adam[name].step(tensor, self._rate(name, progress) * damping)
        self.forget_gradient()

    def hold(self, rows: Tensor) -> None:
        """Discard the gradients of some Gaussians, [G] bool, so that the next step changes only the others."""
        for tensor in self.scene.parameters().values():
            if tensor.grad is not None:
                tensor.grad[rows.to(tensor.device)] = 0

    def forget_gradient(self) -> None:
        """Discard the gradients."""
        for tensor in self.scene.parameters().values():
            tensor.grad = None

    def gradient_is_finite(self) -> bool:
        """Tell whether all gradients are free of NaN and infinities."""
        return all_finite(*(t.grad for t in self.scene.parameters().values() if t.grad is not None))

    def scene_is_finite(self) -> bool:
        """Tell whether all parameters are free of NaN and infinities."""
        return all_finite(*(tensor.detach() for tensor in self.scene.parameters().values()))

    def let_colours_vary(self, degree: int) -> None:
        """Let colours change with direction up to a degree; new coefficients start at zero."""
        present = degree_of(self.scene)
        if degree <= present:
            return
        had, columns = coefficients(present), coefficients(degree)
        added = self.scene.means.new_zeros((len(self.scene), columns - had, 3))
        held = [] if self.scene.harmonics is None else [self.scene.harmonics.detach()]
        self.scene = replace(self.scene, harmonics=torch.cat([*held, added], dim=1).requires_grad_(True))
        self._adam.setdefault("harmonics", Adam(decay=self._sizes.momentum)).widen(columns)

    def shift(self, means: Tensor) -> None:
        """Move the means by so much, [G, 3], without changing Adam's moments."""
        with torch.no_grad():
            self.scene.means.add_(means)

    def replace(self, scene: Gaussians, source: Tensor, forget: frozenset[str] = frozenset()) -> None:
        """Continue with other Gaussians.

        Args:
            scene: The new Gaussians, G'.
            source: [G'] int64: which of the present ones each of them continues (its moments are kept), or -1 for
                a new one (whose moments start at zero).
            forget: Names of parameters whose moments start at zero for all.
        """
        for name, adam in self._adam.items():
            adam.follow(source, forget=name in forget)
        self.scene = _leaves(scene)

    def state(self) -> dict[str, Adam]:
        """Return the moments of each parameter; the next step changes their numbers."""
        return {name: replace(adam) for name, adam in self._adam.items()}

    def resume(self, scene: Gaussians, moments: Mapping[str, Adam]) -> None:
        """Go on from the state of another."""
        self.restore(scene)
        for name, adam in moments.items():
            self._adam[name].resume(adam, scene.means.device)

    def restore(self, scene: Gaussians) -> None:
        """Go back to a snapshot; Adam forgets its moments, which led away from it."""
        self.scene = _leaves(scene)
        self._begin()


def _leaves(scene: Gaussians) -> Gaussians:
    return scene.map(lambda tensor: tensor.detach().clone().requires_grad_(True))

"""The presets: settings by name, from quick to accurate. Data alone; no stage reads the name of a preset.

Here: what each preset sets, and how a schedule is made shorter or longer. Not here: what the settings mean (each
stage's own file), the paper's constants (`paper`), which preset suits a number of seconds (`budget`).
"""

from dataclasses import replace
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.choices import PresetName
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.optimiser.gaussians import StepSizes
from gs2ci.reconstruct.fit.surfaces.surfaces import Search, SurfaceSettings
from gs2ci.reconstruct.paper.preset import paper_settings
from gs2ci.reconstruct.settings import Settings

_DRAFT_ITERATIONS: Final = 120


def rescheduled(fit: CoarseSettings, iterations: int) -> CoarseSettings:
    """Return the same fit on a schedule of another length.

    Looks at the held-out pixels, applications of the density rule and patience scale with the schedule, within bounds;
    a shorter schedule gets larger steps (`StepSizes.of_schedule`).
    """
    look_every = min(50, max(10, iterations // 8))
    return replace(
        fit,
        iterations=iterations,
        densify_every=min(100, max(10, iterations // 8)),
        steps=StepSizes.of_schedule(iterations),
        hold_out=fit.hold_out.looking(look_every),
    )


def _draft() -> Settings:
    """A quick result: fewer decode steps and planes, no decode by patches, one short fit of fewer Gaussians."""
    base = Settings()
    # A second search takes a tenth of a draft, for 0.1 dB in the mean.
    surfaces = SurfaceSettings(searches=(Search(0.4, 3e-2, 1e-3),))
    fit = rescheduled(replace(base.fit, gaussians_per_pixel=0.2, surfaces=surfaces), _DRAFT_ITERATIONS)
    return replace(
        base,
        decode=replace(base.decode, iterations=20),
        long_decode=None,
        polish=None,
        geometry=replace(base.geometry, sweep=replace(base.geometry.sweep, planes=48)),
        # A look decodes the residual, which takes as long as an iteration and a half.
        fit=replace(fit, hold_out=fit.hold_out.looking(_DRAFT_ITERATIONS // 4)),
        fits=1,
    )


# The one place that says what a name means.
PRESETS: Final[dict[PresetName, Settings]] = {
    "draft": _draft(),
    "standard": Settings(),
    "paper": paper_settings(),
}


def preset(name: PresetName) -> Settings:
    """Return the settings of a preset.

    Raises:
        InputError: There is none of that name.
    """
    if name not in tuple(PRESETS):
        raise InputError(f"no preset {name!r}", allowed=", ".join(PRESETS))
    return PRESETS[name]

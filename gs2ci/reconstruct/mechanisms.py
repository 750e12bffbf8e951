"""The mechanisms of a reconstruction, each with the switch that leaves it out: what a table can take away.

A mechanism is a step without which a reconstruction still works, and which has to show on new data that it is worth its
time and its code (CONTRIBUTING, "How to change quality"). Figures of each, and of those that were deleted, are in
docs/mechanisms.md.

Here: names, switches, and the decisions that let them in. Not here: the components of the paper's own ablation
(`presets.ablation`), the table (docs/tables.md).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.fit.surfaces.surfaces import SurfaceSettings
from gs2ci.reconstruct.settings import Settings

Switch = Callable[[Settings], Settings]


@dataclass(frozen=True)
class Mechanism:
    """One mechanism.

    Args:
        name: In tables and on the command line.
        what: What it does, in one sentence.
        without: Returns settings that leave it out.
        decision: The record that let it in, by its file's name in docs/decisions.
    """

    name: str
    what: str
    without: Switch
    decision: str


def _set(settings: Settings, **changes: Any) -> Settings:
    return replace(settings, **changes)


def _fit(settings: Settings, **changes: Any) -> Settings:
    return replace(settings, fit=replace(settings.fit, **changes))


def _surfaces(settings: Settings, change: Callable[[SurfaceSettings], SurfaceSettings]) -> Settings:
    surfaces = settings.fit.surfaces
    return settings if surfaces is None else _fit(settings, surfaces=change(surfaces))


def _unexchanged(surfaces: SurfaceSettings) -> SurfaceSettings:
    field = surfaces.depth_field
    return surfaces if field is None else replace(surfaces, depth_field=replace(field, exchange=None))


def _left_out(name: LeftOut, settings: Settings) -> Settings:
    geometry = replace(settings.geometry, left_out=(*settings.geometry.left_out, name))
    return replace(settings, left_out=(*settings.left_out, name), geometry=geometry)


_NAMED: Final[dict[str, dict[LeftOut, str]]] = {
    "sources-of-geometry": {
        LeftOut.TRACKS_SOUGHT_TWICE: "tracks are sought again where a rough depth map predicts them",
        LeftOut.ADJUSTMENT_OF_POINTS: "points may leave the rays of their corners in a second bundle adjustment",
        LeftOut.DISPLACEMENTS: "the path that explains displacements of blocks of the measurement replaces worse ones",
    },
    "wide-baseline": {
        LeftOut.MATCHES_IN_A_LONGER_DECODE: "features of all pairs of views are matched again in a longer decode",
    },
    "path-from-fits": {
        LeftOut.SECOND_LOOK: "a doubtful or missing path is estimated again from the views of a fit",
    },
    "moving-scenes": {
        LeftOut.DENSE_POLISH: "refined views of scenes in which things may move are decoded on by dense patches",
    },
    "combination": {
        LeftOut.ERRORS_OVER_TIME: "views that surely err over time are replaced by those of the decode",
        LeftOut.CANCELLING_ERRORS: "where patches explained much, errors of scenes are taken to cancel along the views",
    },
    "residual-and-polish": {
        LeftOut.DECODE_WEIGHS_NOISE: "the decode that may join the delivered views weighs the noise of the readings",
    },
    "many-exposures": {
        LeftOut.REPEATS_DECODED_TOGETHER: "exposures that repeat a path are found and decoded together, in joint runs",
    },
}

MECHANISMS: Final[tuple[Mechanism, ...]] = (
    Mechanism(
        "registration",
        "masks are corrected as far as the measurement shows them to be wrong",
        lambda settings: _set(settings, registration=replace(settings.registration, mode="off")),
        "registration",
    ),
    Mechanism(
        "restored masks",
        "masks of open and closed elements that are stated soft, resampled or crisp with noise are restored",
        lambda settings: _set(settings, registration=replace(settings.registration, restores=False)),
        "registration",
    ),
    Mechanism(
        "brightness",
        "weights of the masks are corrected from the measurement",
        lambda settings: _set(settings, brightness=replace(settings.brightness, rounds=0)),
        "brightness",
    ),
    Mechanism("second fit", "the views are the mean of two fits", partial(_set, fits=1), "several-fits"),
    Mechanism(
        "generous companion",
        "the second fit has a density rule that splits more",
        partial(_set, second_density=None),
        "several-fits",
    ),
    Mechanism(
        "moments within masks",
        "a mask behind which the camera moves has several poses",
        lambda settings: _set(settings, mask_moments=replace(settings.mask_moments, within_mask="still")),
        "sub-exposure-samples",
    ),
    Mechanism(
        "surfaces", "light is drawn to surfaces on which swept views agree", partial(_fit, surfaces=None), "surfaces"
    ),
    Mechanism(
        "depth field",
        "a smooth field moves the depths of whole regions",
        lambda settings: _surfaces(settings, lambda one: replace(one, depth_field=None)),
        "steps",
    ),
    Mechanism(
        "relief exchange",
        "turning of cameras is exchanged for travel, with a constant that the depth field adds to all inverse depths",
        lambda settings: _surfaces(settings, _unexchanged),
        "steps",
    ),
    Mechanism(
        "margin",
        "the scene is continued beyond the borders of all views",
        lambda settings: _surfaces(settings, lambda one: replace(one, margin=None)),
        "surfaces",
    ),
    Mechanism(
        "steps in the reference view",
        "positions step in pixels of the reference view",
        lambda settings: _fit(settings, steps=replace(settings.fit.steps, in_view=None)),
        "steps",
    ),
    Mechanism(
        "pose refinement",
        "poses are fitted together with the scene",
        lambda settings: _fit(settings, poses=replace(settings.fit.poses, refine=False)),
        "steps",
    ),
    Mechanism(
        "residual",
        "the residual of the scene is decoded and added",
        partial(_set, residual=None),
        "residual-and-polish",
    ),
    Mechanism(
        "polish", "refined views are decoded on by similar patches", partial(_set, polish=None), "residual-and-polish"
    ),
    Mechanism(
        "long decode",
        "the decode by similar patches that may join or start fits",
        partial(_set, long_decode=None),
        "patch-decoder",
    ),
    *(
        Mechanism(name.value, what, partial(_left_out, name), decision)
        for decision, named in _NAMED.items()
        for name, what in named.items()
    ),
)
"""In the order in which a reconstruction comes to them, as far as there is one."""


def mechanism(name: str) -> Mechanism:
    """Return a mechanism by its name.

    Raises:
        InputError: There is none of that name.
    """
    for one in MECHANISMS:
        if one.name == name:
            return one
    raise InputError(f"mechanism {name!r}", allowed=", ".join(one.name for one in MECHANISMS))

"""The number and the times of the views that sample a moving image: as few as the tolerance allows.

Here: the choice among panels of time (`moments`), by the bounds of `effects.motion_blur` and `waves`. Not here: which
effects are simulated (`planner`, the only user), how grain is measured (`grain`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Effect, LightStage
from gs2ci_sims.effects.motion_blur import MotionBlur, sampling_bound
from gs2ci_sims.grain import BURSTS, LENGTH_PX, MeasuredGrain
from gs2ci_sims.grain import VIEWS as GRAIN_VIEWS
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.moments import Moments, one_per_interval
from gs2ci_sims.path import kinks_s
from gs2ci_sims.preview import Preview
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.signals import Slices, nominal_slices
from gs2ci_sims.waves import CollectedWaves

_Family = tuple[F64, tuple[int, ...], bool]

# Panels within a mask interval, and views within such a panel.
PARTS: Final = (1, 2, 3, 5, 9, 15, 27, 45)
NODES_WITHIN: Final = (1, 2, 3, 4, 5, 6, 7, 8, 9)
# Views within a panel that spans several masks, and the largest number of such panels per mask.
NODES: Final = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12)
PANELS_PER_MASK: Final = 4
PANEL_CHOICES: Final = 14
TRAVEL_STEPS: Final = 512
# If no option is within the budget, the cheapest is chosen of those whose bound exceeds the best one by at most this
# share of the budget; no option has more views per mask than the last figure.
ALIKE_SHARE: Final = 0.1
VIEWS_PER_MASK_MAX: Final = 405
# Once an option is within the budget, panels with fewer views than this are not evaluated any more.
NODES_WORTH: Final = 3
# A jump of velocity nearer to the end of a panel than this share of the panel is ignored.
NEAR_SHARE: Final = 0.02
# Grain is measured where its constant alone calls for this many times as many more views as measuring takes, a mask
# counted as half a view.
GRAIN_PAYS: Final = 2.0


@dataclass(frozen=True)
class Sampling:
    """The sampling of the moving image.

    Args:
        blur: The motion blur with this sampling; None for one view per mask, which has no motion blur.
        views: Number of rendered views.
        error_dn: Bound of the difference from infinitely many views, DN rms.
        how: Description for reports.
        why: Reason for reports.
    """

    blur: MotionBlur | None
    views: int
    error_dn: float
    how: str
    why: str


def choose_sampling(
    look: Preview,
    effects: Sequence[Effect],
    budget_dn: float,
    *,
    seed: int,
    blurs: bool,
    slices: Slices | None = None,
    renderer: Renderer | None = None,
) -> Sampling:
    """Choose the smallest number of views that keeps the error within the budget; if none does, the best one.

    Args:
        look: A quick look, with all motion that is simulated.
        effects: The simulated effects; those that act on time determine how evenly light is collected.
        budget_dn: Budget of the error, DN rms.
        seed: Seed of the exposure.
        blurs: False if motion blur is switched off: each mask sees one view.
        slices: The times of the masks before effects, if they differ from the rig's timing; masks then switch anywhere
            within a panel.
        renderer: Draws some views to measure its grain, where that saves more of them; None does not measure it.
    """
    count = len(look.masks)
    chain = EffectChain([effect for effect in effects if effect.stage is LightStage.TIME], seed, look.rig)
    irregular = slices is not None
    slices = chain.through(LightStage.TIME, slices or nominal_slices(look.intervals_s)).cut_by_rows(look.scene.size[0])
    travel = _travel(look, slices)
    if travel[1][-1] == 0:
        whole = (float(travel[0][0]), float(travel[0][-1]))
        return Sampling(MotionBlur(1, whole), 1, 0.0, "1 in all", "nothing moves")
    if not (slices.mix.any(axis=1) & (slices.duration_s > 0)).any():
        return Sampling(None, count, 0.0, "", "no light is collected")
    bounding = _Bounding(look, slices)
    plain = one_per_interval(look.intervals_s)
    if not blurs:
        return Sampling(None, count, bounding.error_dn(plain), "", "forced off")
    kinks = kinks_s(look.path, float(travel[0][0]), float(travel[0][-1]))
    families = [*_across_masks(look, travel, kinks)]
    if not irregular:
        families = [*_within_masks(look, kinks), *families]
    if renderer is not None and _may_measure(look, travel, budget_dn):
        constant, bounding.grain_dn = bounding.grain_dn, _no_grain
        least = _cheapest(bounding, plain, families, budget_dn, count)
        bounding.grain_dn = constant
        if least.fits and _measuring_pays(look, least.views, budget_dn):
            bounding.grain_dn = MeasuredGrain(look, renderer, slices, travel).rms_dn
    return _as_sampling(look, _cheapest(bounding, plain, families, budget_dn, count))


def _may_measure(look: Preview, travel: tuple[F64, F64], budget_dn: float) -> bool:
    """Return whether grain can be measured, and might decide: rays through meshes alias over longer ways."""
    far_enough = float(travel[1][-1]) >= BURSTS * LENGTH_PX
    return far_enough and look.scene.mesh is None and _measuring_pays(look, 0, budget_dn)


def _measuring_pays(look: Preview, least: int, budget_dn: float) -> bool:
    """Return whether the constant of the grain calls for many more views than the motion does (`least`)."""
    # Its variance is one over the number of views, until they are too close together.
    count = len(look.masks)
    called_for = count * (look.graininess(count) / max(budget_dn, 1e-300)) ** 2
    return called_for - least > GRAIN_PAYS * (GRAIN_VIEWS + 0.5 * count)


def _no_grain(_moments: Moments) -> float:
    return 0.0


def _cheapest(
    bounding: "_Bounding", plain_moments: Moments, families: Sequence[_Family], budget_dn: float, count: int
) -> "_Option":
    """Return the option with the fewest views within the budget; if there is none, the cheapest that is nearly best."""
    plain_dn = bounding.error_dn(plain_moments)
    plain = _Option(plain_moments, plain_dn, plain_dn <= budget_dn, plain=True)
    best = plain if plain.fits else None
    fallback = [plain]
    most = VIEWS_PER_MASK_MAX * count
    for edges, nodes, across in families:
        panels = len(edges) - 1
        limit = most if best is None else best.views - 1
        open_nodes = [node for node in nodes if panels * node <= limit]
        if not open_nodes or (best is not None and open_nodes[-1] < NODES_WORTH):
            continue
        # More views in the same panels have a smaller error: the finest shows whether the others need be evaluated.
        low, high = 0, len(open_nodes) - 1
        finest = bounding.option(edges, open_nodes[high], across, budget_dn)
        fallback.append(finest)
        if not finest.fits:
            continue
        best = finest
        while low < high:
            middle = (low + high) // 2
            option = bounding.option(edges, open_nodes[middle], across, budget_dn)
            if option.fits:
                best, high = option, middle
            else:
                low = middle + 1
    if best is None:
        tolerated = min(option.error_dn for option in fallback) + ALIKE_SHARE * budget_dn
        best = min((option for option in fallback if option.error_dn <= tolerated), key=lambda option: option.views)
    return best


@dataclass(frozen=True)
class _Option:
    """Moments, the bound of their error, DN rms, and whether it is within the budget.

    `across`: panels span several masks; `plain`: one view per mask.
    """

    moments: Moments
    error_dn: float
    fits: bool
    across: bool = False
    plain: bool = False

    @property
    def views(self) -> int:
        return (len(self.moments.edges_s) - 1) * self.moments.nodes


class _Bounding:
    """Error bounds of options, from the light that each mask collects.

    `grain_dn` says what grain makes of the readings; bounds of the motion are kept for when it is replaced.
    """

    def __init__(self, look: Preview, slices: Slices) -> None:
        self._look = look
        self._waves = CollectedWaves(look.scene, look.path, slices, look.object_px_per_s)
        self._kept: dict[tuple[bytes, int], float] = {}
        self.grain_dn: Callable[[Moments], float] = lambda moments: look.graininess(len(moments.times_s))

    def error_dn(self, moments: Moments) -> float:
        """Bound the error of these moments, DN rms: what motion between the views and grain make of the readings."""
        key = (moments.edges_s.tobytes(), moments.nodes)
        if key not in self._kept:
            self._kept[key] = sampling_bound(self._look, self._waves, moments).rms_dn
        return self._kept[key] + self.grain_dn(moments)

    def option(self, edges_s: F64, nodes: int, across: bool, budget_dn: float) -> _Option:
        """Bound an option."""
        moments = Moments(edges_s, nodes)
        error_dn = self.error_dn(moments)
        return _Option(moments, error_dn, error_dn <= budget_dn, across)


def _as_sampling(look: Preview, option: _Option) -> Sampling:
    count, views = len(look.masks), option.views
    if option.plain:
        return Sampling(None, count, option.error_dn, "", "one view per mask will do")
    blur = MotionBlur(option.moments.nodes, tuple(float(edge) for edge in option.moments.edges_s))
    if option.across:
        return Sampling(blur, views, option.error_dn, f"{views} in all", "the image moves little")
    how = f"{views // count} per mask" if views % count == 0 else f"{views} in all"
    return Sampling(blur, views, option.error_dn, how, "the image moves")


def _across_masks(look: Preview, travel: tuple[F64, F64], kinks: F64) -> Iterator[_Family]:
    """List panels with equal shares of the motion, whether or not masks switch in them."""
    times, travelled = travel
    # A small term in time, added to the motion, separates panels while the image is at rest.
    progress = travelled / travelled[-1] + 1e-6 * np.linspace(0, 1, len(times))
    most = PANELS_PER_MASK * len(look.masks)
    for panels in np.unique(np.rint(np.geomspace(1, most, PANEL_CHOICES)).astype(int)):
        ends = np.interp(cut_at(kinks, times[[0, -1]], NEAR_SHARE / panels), times, progress)
        parts = np.maximum(np.rint(panels * np.diff(ends) / progress[-1]).astype(int), 1)
        pieces = zip(ends[:-1], ends[1:], parts, strict=True)
        even = [np.linspace(begin, end, part + 1) for begin, end, part in pieces]
        yield np.interp(np.unique(np.concatenate(even)), progress, times), NODES, True


def _within_masks(look: Preview, kinks: F64) -> Iterator[_Family]:
    """List panels that divide the mask intervals."""
    count = len(look.masks)
    for parts in PARTS:
        within = look.intervals_s[:, :1] + np.diff(look.intervals_s, axis=1) * np.linspace(0, 1, parts + 1)
        edges = cut_at(kinks, _distinct(within.ravel()))
        yield edges, tuple(node for node in NODES_WITHIN if (len(edges) - 1) * node > count), False


def cut_at(kinks: F64, edges: F64, near: float = NEAR_SHARE) -> F64:
    """Return the edges of panels, cut also at those kinks that lie well within a panel.

    If the velocity jumps within a panel, polynomials converge slowly; before and after the jump they converge fast. Of
    jumps that are closer together than the share `near` of a panel, as those of a stage that reverses and then takes up
    its backlash, only the first is used: a panel between them would need as many views as any other.
    """
    inside = np.sort(kinks[(kinks > edges[0]) & (kinks < edges[-1])])
    panel = np.searchsorted(edges, inside) - 1
    width = np.diff(edges)[panel]
    share = (inside - edges[panel]) / width
    kept: list[float] = []
    far = np.minimum(share, 1 - share) > near
    for kink, least in zip(inside[far], near * width[far], strict=True):
        if not kept or kink - kept[-1] > least:
            kept.append(float(kink))
    return np.unique(np.concatenate([edges, kept]))


def _distinct(edges: F64) -> F64:
    """Drop edges that are equal up to rounding."""
    keep = np.concatenate([[True], np.diff(edges) > 1e-9 * (edges[-1] - edges[0])])
    return np.asarray(edges[keep])


def unevenness(slices: Slices) -> float:
    """Return the deviation of the mixture of masks from its mean while one of them is shown, as a share.

    If rows are exposed at different times, the unevenness has its largest value.
    """
    if slices.shutter is not None:
        return 1.0
    worst = 0.0
    for n in np.unique(slices.shown):
        mine = slices.shown == n
        share = slices.duration_s[mine] / max(float(slices.duration_s[mine].sum()), 1e-300)
        mean = share @ slices.mix[mine]
        worst = max(worst, float((share @ np.abs(slices.mix[mine] - mean)).sum()))
    return worst


def _travel(look: Preview, slices: Slices) -> tuple[F64, F64]:
    """Follow the image's motion over the times of the slices and of the masks' intervals."""
    start = min(float(slices.start_s.min(initial=np.inf)), float(look.intervals_s[0, 0]))
    stop = max(float(slices.stop_s.max(initial=-np.inf)), float(look.intervals_s[-1, 1]))
    times = np.linspace(start, stop, TRAVEL_STEPS)
    return times, look.travel_px(times)

"""How many views stand for a moving image, and when they are rendered: as few as the tolerance allows.

Here: the choice among panels of time (`moments`), by the bounds of `effects.motion_blur`. Not here: which effects are
simulated (`planner`, the only user).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Effect, Stage
from gs2ci_sims.effects.motion_blur import MotionBlur, even_panel_rms_dn, panel_bound
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.motion import net_motion_px
from gs2ci_sims.path import kinks_s
from gs2ci_sims.preview import Preview
from gs2ci_sims.signals import Slices, nominal_slices

# Panels within a mask interval, and views within such a panel.
PARTS: Final = (1, 2, 3, 5, 9, 15, 27, 45)
NODES_WITHIN: Final = (1, 2, 3, 4, 5, 6, 7, 8, 9)
# Views within a panel that spans several masks, and how many such panels per mask at most.
NODES: Final = (1, 2, 3, 4, 5, 6, 8, 10, 12)
PANELS_PER_MASK: Final = 4
PANEL_CHOICES: Final = 14
# Options are only reckoned in full whose error would be within the budget if the image moved evenly, by this share of
# its net motion's error (panels differ, and only the fastest is guessed at).
GUESS_SHARE: Final = 0.3
# Of an option that was reckoned in vain, this share of its error over the guess counts for all with the same panels.
LEARNED_SHARE: Final = 0.7
TRAVEL_STEPS: Final = 512
# If no option stays within its budget, the cheapest is taken of those that promise no more than this share of the
# budget above the best; none has more views per mask than the last figure.
ALIKE_SHARE: Final = 0.1
VIEWS_PER_MASK_MAX: Final = 405
# A jump of velocity that lies nearer to the end of a panel than this share of the panel is passed over.
NEAR_SHARE: Final = 0.02


@dataclass(frozen=True)
class Sampling:
    """How the moving image is sampled.

    Args:
        blur: The effect so sampled; None: one view per mask, which is no motion blur.
        views: How many views are rendered.
        error_dn: Bound of what infinitely many would change, DN rms.
        how: For reports.
        why: For reports.
    """

    blur: MotionBlur | None
    views: int
    error_dn: float
    how: str
    why: str


def choose_sampling(
    look: Preview, effects: Sequence[Effect], budget_dn: float, *, seed: int, blurs: bool, slices: Slices | None = None
) -> Sampling:
    """Choose the smallest number of views that keeps the error within the budget; failing that, the best there is.

    Args:
        look: A quick look, with all motion that is simulated.
        effects: Those that are simulated; the ones that act on time decide how evenly light is collected.
        budget_dn: For the error, DN rms.
        seed: The exposure's.
        blurs: False: motion blur is forced off, each mask sees one view.
        slices: When which mask is on show, before effects, if not as the rig's timing says; masks then switch
            anywhere within a panel.
    """
    count = len(look.masks)
    chain = EffectChain([effect for effect in effects if effect.stage is Stage.TIME], seed, look.rig)
    irregular = slices is not None
    slices = chain.through(Stage.TIME, slices or nominal_slices(look.intervals_s))
    travel = _travel(look, slices)
    if travel[1][-1] == 0:
        whole = (float(travel[0][0]), float(travel[0][-1]))
        return Sampling(MotionBlur(1, whole), 1, 0.0, "1 in all", "nothing moves")
    uneven = unevenness(slices)
    plain = _Option(np.unique(look.intervals_s), 1, 0.0, uneven, count)
    if not blurs:
        return Sampling(None, count, _error(look, plain), "", "forced off")
    kinks = kinks_s(look.path, float(travel[0][0]), float(travel[0][-1]))
    options = [*_across_masks(look, travel, kinks)]
    if not irregular:
        options += [plain, *_within_masks(look, uneven, kinks)]
    options.sort(key=lambda option: option.views)
    options = [option for option in options if option.views <= VIEWS_PER_MASK_MAX * count]
    learned: dict[int, float] = {}
    for option in options:
        share = learned.get(id(option.edges_s), GUESS_SHARE)
        if _guess(look, option, share) <= budget_dn:
            error = _error(look, option)
            if error <= budget_dn:
                return _as_sampling(look, option, plain, error)
            # With more nodes in the same panels, what is off from an even motion only counts for more.
            grain = look.graininess(option.views)
            even = _guess(look, option, 1.0) - grain
            if even > 0:
                learned[id(option.edges_s)] = max(share, LEARNED_SHARE * (error - grain) / even)
    guesses = [_guess(look, option) for option in options]
    tolerated = min(guesses) + ALIKE_SHARE * budget_dn
    last = next(option for option, guess in zip(options, guesses, strict=True) if guess <= tolerated)
    return _as_sampling(look, last, plain, _error(look, last))


@dataclass(frozen=True)
class _Option:
    """Panels between `edges_s` with `nodes` views each, the image's net motion over which is `panel_px` at most."""

    edges_s: F64
    nodes: int
    panel_px: float
    unevenness: float | None
    views: int


def _guess(look: Preview, option: _Option, share: float = GUESS_SHARE) -> float:
    """Guess an option's error from its net motion, DN rms: cheap, and rather too small than too large."""
    even = even_panel_rms_dn(look, option.panel_px, option.nodes, option.unevenness)
    return share * even + look.graininess(option.views)


def _error(look: Preview, option: _Option) -> float:
    """Bound an option's error, DN rms."""
    bound = panel_bound(look, option.edges_s, option.nodes, option.unevenness)
    return bound.rms_dn + look.graininess(option.views)


def _as_sampling(look: Preview, option: _Option, plain: _Option, error: float) -> Sampling:
    count = len(look.masks)
    if option is plain:
        return Sampling(None, count, error, "", "one view per mask will do")
    blur = MotionBlur(option.nodes, tuple(float(edge) for edge in option.edges_s))
    if option.unevenness is None:
        return Sampling(blur, option.views, error, f"{option.views} in all", "the image moves little")
    how = f"{option.views // count} per mask" if option.views % count == 0 else f"{option.views} in all"
    return Sampling(blur, option.views, error, how, "the image moves")


def _across_masks(look: Preview, travel: tuple[F64, F64], kinks: F64) -> Iterator[_Option]:
    """List panels that hold equal shares of the motion, whatever masks switch in them."""
    times, travelled = travel
    # A trace of time beside the motion keeps panels apart while the image is at rest.
    progress = travelled / travelled[-1] + 1e-6 * np.linspace(0, 1, len(times))
    most = PANELS_PER_MASK * len(look.masks)
    for panels in np.unique(np.rint(np.geomspace(1, most, PANEL_CHOICES)).astype(int)):
        edges = _cut_at(kinks, np.interp(np.linspace(0, progress[-1], panels + 1), progress, times))
        net_px = net_motion_px(look.scene, look.path, edges)
        for nodes in NODES:
            yield _Option(edges, nodes, net_px, None, (len(edges) - 1) * nodes)


def _within_masks(look: Preview, uneven: float, kinks: F64) -> Iterator[_Option]:
    """List panels that end where mask intervals do."""
    for parts in PARTS:
        within = look.intervals_s[:, :1] + np.diff(look.intervals_s, axis=1) * np.linspace(0, 1, parts + 1)
        edges = _cut_at(kinks, _distinct(within.ravel()))
        net_px = net_motion_px(look.scene, look.path, edges)
        for nodes in NODES_WITHIN:
            if (len(edges) - 1) * nodes > len(look.masks):
                yield _Option(edges, nodes, net_px, uneven, (len(edges) - 1) * nodes)


def _cut_at(kinks: F64, edges: F64) -> F64:
    """Return the edges of panels with those of the kinks among them that lie well within a panel.

    Within a panel whose motion jumps, polynomials converge slowly; up to a jump and from it on, fast.
    """
    inside = kinks[(kinks > edges[0]) & (kinks < edges[-1])]
    panel = np.searchsorted(edges, inside) - 1
    share = (inside - edges[panel]) / np.diff(edges)[panel]
    kept = np.sort(inside[np.minimum(share, 1 - share) > NEAR_SHARE])
    return np.asarray(np.unique(np.concatenate([edges, kept])))


def _distinct(edges: F64) -> F64:
    """Drop edges that repeat but for rounding."""
    keep = np.concatenate([[True], np.diff(edges) > 1e-9 * (edges[-1] - edges[0])])
    return np.asarray(edges[keep])


def unevenness(slices: Slices) -> float:
    """Return how much the mixture of masks deviates from its mean while one of them is on show, as a share.

    Where rows are exposed at different times, the light is as uneven as can be.
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
    """Follow the image's motion over all that the slices cover and all that true views are wanted of."""
    start = min(float(slices.start_s.min(initial=np.inf)), float(look.intervals_s[0, 0]))
    stop = max(float(slices.stop_s.max(initial=-np.inf)), float(look.intervals_s[-1, 1]))
    times = np.linspace(start, stop, TRAVEL_STEPS)
    return times, look.travel_px(times)

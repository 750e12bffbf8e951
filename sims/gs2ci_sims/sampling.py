"""How many views stand for a moving image, and when they are rendered: as few as the tolerance allows.

Here: the choice among panels of time (`moments`), by the bounds of `effects.motion_blur`. Not here: which effects are
simulated (`planner`, the only user).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci_sims.effects.base import Effect, Stage
from gs2ci_sims.effects.motion_blur import MotionBlur, panel_bound
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.preview import Preview
from gs2ci_sims.signals import Slices, nominal_slices

F64 = NDArray[np.float64]

# Panels within a mask interval and views within a panel; odd, so that one view is the middle of the interval, where
# the true view of a shot is.
PARTS: Final = (1, 3, 5, 9, 15, 27, 45, 81)
ODD_NODES: Final = (1, 3, 5, 7, 9)
# Views within a panel that spans several masks, and how many such panels per mask at most.
NODES: Final = (1, 2, 3, 4, 5, 6, 8, 10, 12)
PANELS_PER_MASK: Final = 4
# The rasteriser drops splats below 1/255 of opacity and works in float32: views a hair's breadth apart differ by
# this much, rms, of full scale (measured on planes and the motorcycle; `tests/benchmarks/simulation.py` shows it).
RENDER_FLOOR: Final = 3e-5
TRAVEL_STEPS: Final = 512


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


def choose_sampling(look: Preview, effects: Sequence[Effect], budget_dn: float, *, seed: int, blurs: bool) -> Sampling:
    """Choose the smallest number of views that keeps the error within the budget; failing that, the best there is.

    Args:
        look: A quick look, with all motion that is simulated.
        effects: Those that are simulated; the ones that act on time decide how evenly light is collected.
        budget_dn: For the error, DN rms.
        seed: The exposure's.
        blurs: False: motion blur is forced off, each mask sees one view.
    """
    count = len(look.masks)
    chain = EffectChain([effect for effect in effects if effect.stage is Stage.TIME], seed, look.rig)
    slices = chain.through(Stage.TIME, nominal_slices(look.intervals_s))
    travel = _travel(look, slices)
    plain = panel_bound(look, float(look.motion_px.max()), 1, unevenness(slices))
    if not blurs:
        return Sampling(None, count, plain.rms_dn, "", "forced off")
    floor = look.of_radiance(RENDER_FLOOR, 0.0).rms_dn if travel[1][-1] > 0 else 0.0
    best: Sampling | None = None
    for option in (*_across_masks(look, travel, floor), *_within_masks(look, slices, floor)):
        if best is None or _better(option, best, budget_dn):
            best = option
    assert best is not None
    return best


def _better(option: Sampling, best: Sampling, budget_dn: float) -> bool:
    if (option.error_dn <= budget_dn) != (best.error_dn <= budget_dn):
        return option.error_dn <= budget_dn
    key = "views" if best.error_dn <= budget_dn else "error_dn"
    return bool(getattr(option, key) < getattr(best, key))


def _across_masks(look: Preview, travel: tuple[F64, F64], floor_dn: float) -> Iterator[Sampling]:
    """List panels that hold equal shares of the motion, whatever masks switch in them."""
    times, travelled = travel
    count = len(look.masks)
    still = travelled[-1] == 0
    for panels in range(1, 2 if still else PANELS_PER_MASK * count + 1):
        shares = np.linspace(0, 1, panels + 1)
        # A trace of time beside the motion keeps panels apart while the image is at rest.
        progress = travelled / max(float(travelled[-1]), 1e-300) + 1e-6 * np.linspace(0, 1, len(times))
        edges = np.interp(shares * progress[-1], progress, times)
        for nodes in NODES:
            error = panel_bound(look, float(travelled[-1]) / panels, nodes, None).rms_dn + floor_dn
            views = panels * nodes
            blur = MotionBlur(nodes, tuple(float(edge) for edge in edges))
            what = f"{views} views for {count} masks"
            yield Sampling(blur, views, error, what, "nothing moves" if still else "the image moves little")
            if still:
                return


def _within_masks(look: Preview, slices: Slices, floor_dn: float) -> Iterator[Sampling]:
    """List panels that end where mask intervals do."""
    count = len(look.masks)
    uneven = unevenness(slices)
    fastest = float(look.motion_px.max())
    for parts in PARTS:
        within = look.intervals_s[:, :1] + np.diff(look.intervals_s, axis=1) * np.linspace(0, 1, parts + 1)
        edges = tuple(float(edge) for edge in _distinct(within.ravel()))
        for nodes in ODD_NODES:
            error = panel_bound(look, fastest / parts, nodes, uneven).rms_dn + floor_dn
            if parts * nodes == 1:
                yield Sampling(None, count, error, "", "one view per mask will do")
            else:
                how = f"{parts * nodes} views per mask"
                yield Sampling(MotionBlur(nodes, edges), count * parts * nodes, error, how, "the image moves")


def _distinct(edges: F64) -> F64:
    """Drop edges that repeat but for rounding."""
    keep = np.concatenate([[True], np.diff(edges) > 1e-9 * (edges[-1] - edges[0])])
    return np.asarray(edges[keep])


def unevenness(slices: Slices) -> float:
    """Return how much the mixture of masks deviates from its mean while one of them is on show, as a share.

    Where rows are exposed at different times, the light is as uneven as can be.
    """
    if slices.rows is not None:
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

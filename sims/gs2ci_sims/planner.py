"""Which effects a measurement calls for, and how finely each must be sampled: the cheapest that meets a tolerance.

Every effect bounds what leaving it out would change (`Effect.bound`); what is left out, and what is sampled
coarsely, adds up to no more than one tolerance in total: systematic changes in sum, independent noises in quadrature.
The tolerance is on the reading before counting and rounding: the mean that its noise has, and the noise that was left
out. (Rounding turns a difference of 0.01 DN into one whole DN at every hundredth pixel; two readings of the real
sensor differ by more than that.) Not here: the effects, the exposure, reading rig files (`rig_file`).
"""

import dataclasses
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, Effect, KernelEffect, Stage
from gs2ci_sims.effects.full_well import FullWell
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.quantisation import Quantisation
from gs2ci_sims.exact import ExactRenderer, rendering_error
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.path import CameraPath
from gs2ci_sims.preview import Preview, preview
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Rig
from gs2ci_sims.sampling import Sampling, choose_sampling, unevenness
from gs2ci_sims.scene import Scene
from gs2ci_sims.signals import Slices, nominal_slices

DEFAULT_TOLERANCE_DN: Final = 0.25
# As many readings as the widest converter has: beyond, every simulation would do.
MOST_TOLERANCE_DN: Final = 2.0**16
# Effects left out may use up half of the tolerance, kernels that are cut off a tenth, sampling in time the rest.
OMISSION_SHARE: Final = 0.5
# Of the whole, the error of a fast renderer may use up as much as this; what is left is shared as above.
RENDERING_SHARE: Final = 0.25
KERNEL_SHARE: Final = 0.1
# Why an effect is left out that nobody forced off.
WITHIN: Final = "within the tolerance"
IDLE: Final = "changes nothing here"
OMITTED: Final = (WITHIN, IDLE)
# Why an effect is simulated that could be left out.
CHEAP: Final = "costs nearly nothing"
# An effect is cheap that costs less than this share of drawing the views, at so many nanoseconds per pixel of a view
# (the rasteriser takes 600 to 1300 at 48 x 64 px); light is as even as before if its unevenness grows by no more than
# the last figure.
CHEAP_SHARE: Final = 0.03
VIEW_NS: Final = 1000.0
UNEVEN_MORE: Final = 0.01
# A bound below this share of the tolerance is not worth simulating however cheap the effect is.
NEGLIGIBLE_SHARE: Final = 0.02
# Where kernels may be cut off, in standard deviations.
REACHES: Final = (2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)


@dataclass(frozen=True)
class Decision:
    """What was decided about one effect.

    Args:
        name: The effect's.
        bound: Of what leaving it out would change.
        simulated: Whether it is simulated.
        why: A few words.
        sampling: How finely; empty where there is nothing to choose.
        seconds: What it is expected to cost; 0 where it is left out.
    """

    name: str
    bound: Bound
    simulated: bool
    why: str
    sampling: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class Plan:
    """What will be simulated, and why.

    Args:
        tolerance_dn: What was asked for, DN rms.
        error_dn: Upper bound of what is given up in total, DN rms, forced omissions aside.
        effects: Those to simulate, as sampled.
        decisions: One per effect of the rig, in physical order.
        views: How many views will be rendered.
        render_seconds: What rendering them is expected to cost.
        renderer: What is to draw them.
        omission_limit_dn: What all effects that are left out may change in sum, DN rms.
    """

    tolerance_dn: float
    error_dn: float
    effects: tuple[Effect, ...]
    decisions: tuple[Decision, ...]
    views: int
    render_seconds: float
    renderer: Renderer = field(default_factory=Renderer)
    omission_limit_dn: float = 0.0

    def omitted_dn(self, *, including: Decision | None = None, without: str = "") -> float:
        """Bound what the effects change that were left out for being small, DN rms.

        Args:
            including: One to count whatever was decided of it.
            without: The name of one not to count.
        """
        counted = {one.name: one.bound for one in self.decisions if one.why in OMITTED and one.name != without}
        if including is not None:
            counted[including.name] = including.bound
        return math.hypot(*_total(list(counted.values())))

    def _repr_png_(self) -> bytes:
        """Show what leaving each effect out would change, beside the tolerance; simulated effects are filled."""
        return _drawn(self)

    def _repr_html_(self) -> str:
        from gs2ci.core.notebook import sheet  # noqa: PLC0415  pictures are drawn where somebody looks

        rows = [
            (
                decision.name,
                "unavoidable" if math.isinf(decision.bound.rms_dn) else f"{decision.bound.rms_dn:.3g}",
                "yes" if decision.simulated else "no",
                decision.why,
                decision.sampling,
            )
            for decision in self.decisions
        ]
        headings = ("effect", "at stake, DN rms", "simulated", "why", "sampling")
        return sheet(self.summary(), headings, rows, self._repr_png_())

    @property
    def seconds(self) -> float:
        """Get what the simulation is expected to cost."""
        return self.render_seconds + sum(decision.seconds for decision in self.decisions)

    def summary(self) -> str:
        """Say in one line what is simulated."""
        simulated = sum(decision.simulated for decision in self.decisions)
        met = "" if self.error_dn <= self.tolerance_dn else ", NOT MET"
        return (
            f"simulates {simulated} of {len(self.decisions)} effects with {self.views} views"
            f"{' drawn by rays' if isinstance(self.renderer, ExactRenderer) else ''}, within "
            f"{self.error_dn:.2g} DN rms of everything (tolerance {self.tolerance_dn:.2g} DN{met})"
        )

    def record(self) -> dict[str, Any]:
        """Return the plan as plain data, for the provenance of a shot."""
        return {
            "tolerance_dn": self.tolerance_dn,
            "error_dn": self.error_dn,
            "views": self.views,
            "renderer": f"{self.renderer}",
            "effects": {
                decision.name: {
                    "bound_rms_dn": decision.bound.rms_dn if math.isfinite(decision.bound.rms_dn) else "unavoidable",
                    "simulated": decision.simulated,
                    "why": decision.why,
                    "sampling": decision.sampling,
                }
                for decision in self.decisions
            },
        }


def plan(
    scene: Scene,
    path: CameraPath,
    masks: F32,
    rig: Rig,
    effects: Sequence[Effect],
    *,
    tolerance_dn: float = DEFAULT_TOLERANCE_DN,
    on: Collection[str] = (),
    off: Collection[str] = (),
    seed: int = 0,
    slices: Slices | None = None,
    renderer: Renderer | None = None,
    exact: Renderer | None = None,
) -> Plan:
    """Choose the cheapest simulation that stays within the tolerance of simulating everything.

    Args:
        scene: What is seen.
        path: Where the camera is at any time.
        masks: As nominally shown, [N, H, W].
        rig: The figures.
        effects: All that the rig has.
        tolerance_dn: In total, rms over the pixels, more than 0 and no more than there are readings.
        on: Names of effects to simulate whatever their bounds.
        off: Names of effects to leave out whatever their bounds; they do not count against the tolerance.
        seed: The exposure's: effects that shake the camera draw from it.
        slices: When which mask is on show, before effects; as the rig's timing says if not given.
        renderer: Draws the preview's views, and all others where its error is tolerated.
        exact: Draws them where it is not; without one, the scene is what `renderer` makes of it, and that has no error.

    Raises:
        InputError: The tolerance is not positive, or a forced effect is not there or forced both ways.
    """
    _check(effects, tolerance_dn, on, off)
    chain = EffectChain(effects, seed, rig)
    renderer = renderer or Renderer()
    look = preview(scene, path, masks, rig, renderer, effects=chain.effects, seed=seed)
    drawn_dn = 0.0
    if exact is not None:
        drawn_dn = rendering_error(look, exact).rms_dn
        if drawn_dn > RENDERING_SHARE * tolerance_dn:
            renderer, drawn_dn = exact, 0.0
            look = preview(scene, path, masks, rig, exact, effects=chain.effects, seed=seed)
    whole_dn, tolerance_dn = tolerance_dn, tolerance_dn - drawn_dn
    bounds = {effect.name: effect.bound(look, rig) for effect in chain.effects}
    costs = {effect.name: _seconds(effect, look, len(masks)) for effect in chain.effects}
    left_out = _left_out(bounds, costs, OMISSION_SHARE * tolerance_dn, {MotionBlur.name, *on, *off})
    cheap = _for_nothing(chain, look, bounds, left_out, NEGLIGIBLE_SHARE * tolerance_dn, slices)
    left_out -= cheap
    reached = _limits_within_reach(chain, look, bounds, left_out | set(off))
    left_out -= reached
    systematic, noise = _total([bounds[name] for name in left_out])
    budget = math.sqrt(tolerance_dn**2 - noise**2) - systematic
    kept = [effect for effect in chain.effects if effect.name not in left_out and effect.name not in off]
    kernels = sum(isinstance(effect, KernelEffect) for effect in kept)
    share = KERNEL_SHARE * budget / max(kernels, 1)
    kept = [_with_reach(effect, look, rig, share) if isinstance(effect, KernelEffect) else effect for effect in kept]
    spent = KERNEL_SHARE * budget if kernels else 0.0

    moving = _as_moved(look, kept, seed)
    sampling = choose_sampling(moving, kept, budget - spent, seed=seed, blurs=MotionBlur.name not in off, slices=slices)
    sampled = [sampling.blur if isinstance(effect, MotionBlur) else effect for effect in kept]
    simulated = tuple(effect for effect in sampled if effect is not None)
    given_up = systematic + spent + (sampling.error_dn if MotionBlur.name not in off else 0.0)
    return Plan(
        whole_dn,
        math.hypot(given_up + drawn_dn, noise),
        simulated,
        tuple(
            _decision(
                effect, simulated, bounds, sampling, on, off, reached, cheap, _seconds(effect, look, sampling.views)
            )
            for effect in chain.effects
        ),
        sampling.views,
        sampling.views * look.render_s,
        renderer,
        OMISSION_SHARE * tolerance_dn,
    )


def _check(effects: Sequence[Effect], tolerance_dn: float, on: Collection[str], off: Collection[str]) -> None:
    if not 0 < tolerance_dn <= MOST_TOLERANCE_DN:
        raise InputError(f"a tolerance of {tolerance_dn:g} DN", allowed=f"more than 0, at most {MOST_TOLERANCE_DN:g}")
    known = {effect.name for effect in effects}
    for name in (*on, *off):
        if name not in known:
            raise InputError(f"no effect {name!r} to force on or off", allowed=", ".join(sorted(known)))
    both = sorted(set(on) & set(off))
    if both:
        raise InputError(f"effect {both[0]!r} is forced both on and off", remedy="take it off one of the lists")


def _left_out(bounds: dict[str, Bound], costs: dict[str, float], limit_dn: float, fixed: Collection[str]) -> set[str]:
    """Choose what to leave out: dearest per DN first, as long as the total stays within the limit."""
    free = [name for name, bound in bounds.items() if name not in fixed and bound.rms_dn <= limit_dn]
    # An effect that changes nothing is worth leaving out however cheap it is.
    free.sort(key=lambda name: bounds[name].rms_dn / (costs[name] + 1e-9))
    chosen: set[str] = set()
    for name in free:
        if math.hypot(*_total([bounds[other] for other in (*chosen, name)])) <= limit_dn:
            chosen.add(name)
    return chosen


def _for_nothing(
    chain: EffectChain,
    look: Preview,
    bounds: dict[str, Bound],
    left_out: Collection[str],
    negligible_dn: float,
    slices: Slices | None,
) -> set[str]:
    """Name those left out that cost next to nothing, while the views of a moving image could use their share.

    An effect on motion, or one that makes the light uneven within a mask, costs views: it is worth leaving out.
    """
    if look.at_rest:
        return set()
    masks = len(look.masks)
    affordable_s = CHEAP_SHARE * 1e-9 * VIEW_NS * float(math.prod(look.scene.size)) * masks
    timing = [effect for effect in chain.at(Stage.TIME) if effect.name not in left_out]

    def uneven(effects: Sequence[Effect]) -> float:
        through = EffectChain(effects, chain.seed, look.rig).through
        return unevenness(through(Stage.TIME, slices or nominal_slices(look.intervals_s)))

    def cheap(effect: Effect) -> bool:
        if effect.stage is Stage.TIME:
            return uneven([*timing, effect]) <= uneven(timing) + UNEVEN_MORE
        return effect.stage not in (Stage.MOTION, Stage.SCENE) and _seconds(effect, look, masks) <= affordable_s

    candidates = [one for one in chain.effects if one.name in left_out and bounds[one.name].rms_dn > negligible_dn]
    return {effect.name for effect in candidates if cheap(effect)}


def _limits_within_reach(
    chain: EffectChain, look: Preview, bounds: dict[str, Bound], absent: Collection[str]
) -> set[str]:
    """Name what clips readings and is reached by light together with all that simulated effects may add to it.

    The bounds of these limits know of light alone; a sensor full of dark charge meets them in the dark.
    """
    rig = chain.rig
    limits_dn = {
        effect.name: effect.capacity_e * rig.dn_per_e
        if isinstance(effect, FullWell)
        else effect.max_dn - rig.sensor.black_level_dn
        for effect in chain.effects
        if isinstance(effect, FullWell | Quantisation)
    }
    added_dn = sum(
        bounds[effect.name].peak_dn
        for effect in chain.effects
        if effect.stage in (Stage.CHARGE, Stage.READOUT) and effect.name not in (*limits_dn, *absent)
    )
    reading_dn = rig.dn_per_e * float(look.most_e.max()) + added_dn
    return {name for name, limit_dn in limits_dn.items() if reading_dn > limit_dn}


def _total(bounds: Sequence[Bound]) -> tuple[float, float]:
    """Add bounds up: systematic changes, and noises in quadrature; DN rms."""
    systematic = sum(bound.rms_dn for bound in bounds if not bound.random)
    return systematic, math.sqrt(sum(bound.rms_dn**2 for bound in bounds if bound.random))


def _with_reach(effect: KernelEffect, look: Preview, rig: Rig, share_dn: float) -> Effect:
    """Cut the effect's kernel off as near as its share of the tolerance allows."""
    for reach in REACHES:
        if effect.kernel_bound(look, rig, reach).rms_dn <= share_dn:
            break
    return dataclasses.replace(effect, reach=reach)  # type: ignore[type-var]


def _as_moved(look: Preview, kept: Sequence[Effect], seed: int) -> Preview:
    """Return the preview with the motion that the kept effects add to the path's own."""
    chain = EffectChain(kept, seed, look.rig)
    others = tuple(effect for effect in kept if effect.stage is not Stage.MOTION)
    return dataclasses.replace(look, path=chain.through(Stage.MOTION, look.path), effects=others)


def _seconds(effect: Effect, look: Preview, views: int) -> float:
    """Predict what an effect costs, from its cost per pixel of its stage's signal."""
    pixels = float(math.prod(look.scene.size))
    count = {Stage.RADIANCE: views, Stage.MASKS: len(look.masks), Stage.PHOTONS: 1 + len(look.masks)}
    return 1e-9 * effect.cost_ns * pixels * count.get(effect.stage, 1)


def _decision(
    effect: Effect,
    simulated: Sequence[Effect],
    bounds: dict[str, Bound],
    sampling: Sampling,
    on: Collection[str],
    off: Collection[str],
    reached: Collection[str],
    cheap: Collection[str],
    seconds: float,
) -> Decision:
    """Say what was decided about one effect, and why."""
    bound = bounds[effect.name]
    kept = next((other for other in simulated if other.name == effect.name), None)
    if effect.name in off:
        why = "forced off"
    elif effect.name in on:
        why = "forced on"
    elif isinstance(effect, MotionBlur):
        why = sampling.why
    elif math.isinf(bound.rms_dn):
        why = "cannot be left out"
    elif kept:
        # A limit may be reached by light and noise together where either alone would not.
        why = "may be reached" if effect.name in reached and bound.rms_dn == 0 else "exceeds its share"
        why = CHEAP if effect.name in cheap else why
    else:
        why = WITHIN if bound.rms_dn > 0 else IDLE
    how = ""
    if isinstance(kept, MotionBlur):
        how = sampling.how
    elif isinstance(kept, KernelEffect):
        how = f"to {kept.reach:g} sigma"
    return Decision(effect.name, bound, kept is not None, why, how, seconds if kept else 0.0)


def _drawn(decided: Plan) -> bytes:
    """Draw the bounds of a plan as bars on a logarithmic scale; what cannot be left out reaches the edge."""
    import io  # noqa: PLC0415  only where somebody looks

    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  as above
    from matplotlib.figure import Figure  # noqa: PLC0415  as above

    finite = [one.bound.rms_dn for one in decided.decisions if math.isfinite(one.bound.rms_dn)]
    most = 10 * max([decided.tolerance_dn, *finite])
    # Bounds of nothing have no place on this scale; they stand at its beginning.
    least = decided.tolerance_dn * 1e-6
    figure = Figure(figsize=(6.4, 0.5 + 0.26 * (1 + len(decided.decisions))), layout="constrained")
    axes = figure.add_subplot()
    for place, one in enumerate(decided.decisions):
        bound = min(max(one.bound.rms_dn, 1.2 * least), most)
        colour = "tab:blue" if one.simulated else "0.75"
        axes.barh(place, bound - least, left=least, color=colour)
    axes.axvline(decided.tolerance_dn, color="tab:orange", label="tolerance in all")
    axes.set(xscale="log", xlim=(least, most), xlabel="at stake, DN rms (blue: simulated)")
    axes.set_yticks(range(len(decided.decisions)), [one.name for one in decided.decisions], fontsize=8)
    axes.invert_yaxis()
    axes.legend(loc="lower left", fontsize=8)
    file = io.BytesIO()
    FigureCanvasAgg(figure).print_png(file)  # type: ignore[no-untyped-call]
    return file.getvalue()

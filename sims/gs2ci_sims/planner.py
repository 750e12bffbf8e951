"""Which effects a measurement calls for, and how finely each must be sampled: the cheapest that meets a tolerance.

Every effect bounds what leaving it out would change (`Effect.bound`); what is left out, and what is sampled
coarsely, adds up to no more than one tolerance in total: systematic changes in sum, independent noises in quadrature.
The tolerance is on the reading before counting and rounding: the mean that its noise has, and the noise that was left
out. (Rounding turns a difference of 0.01 DN into one whole DN at every hundredth pixel; two readings of the real
sensor differ by more than that.) Not here: the effects, the exposure, the plan
itself (`simulation_plan`), reading rig files (`rig_file`).
"""

import dataclasses
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from gs2ci_sims.effects.base import Bound, Effect, KernelEffect, LightStage, having
from gs2ci_sims.effects.charges import FullWell
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.readout import Quantisation
from gs2ci_sims.exact import rendering_error
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.preview import Preview, preview
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.sampling import Sampling, choose_sampling, unevenness
from gs2ci_sims.signals import Slices, nominal_slices
from gs2ci_sims.simulation_plan import IDLE, WITHIN, Decision, Plan, PlanChoice, SimulationTask, total

# Effects left out may use up half of the tolerance, kernels that are cut off a tenth, sampling in time the rest.
OMISSION_SHARE: Final = 0.5
# Of the whole, the error of a fast renderer may use up as much as this; what is left is shared as above.
RENDERING_SHARE: Final = 0.25
KERNEL_SHARE: Final = 0.1
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


def plan(
    task: SimulationTask,
    choice: PlanChoice | None = None,
    *,
    renderer: Renderer | None = None,
    exact: Renderer | None = None,
) -> Plan:
    """Choose the cheapest simulation that stays within the tolerance of simulating everything.

    Args:
        task: What is to be exposed.
        choice: How exactly; by default to `DEFAULT_TOLERANCE_DN`, with nothing forced on or off.
        renderer: Draws the preview's views, and all others where its error is tolerated.
        exact: Draws them where it is not; without one, the scene is what `renderer` makes of it, and that has no error.

    Raises:
        InputError: The tolerance is out of range, or a forced effect is not there or forced both ways.
    """
    choice = choice or PlanChoice()
    choice.check(task.effects)
    rig, seed, tolerance_dn = task.rig, task.seed, choice.tolerance_dn
    chain = EffectChain(task.effects, seed, rig)

    def seen_by(drawing: Renderer) -> Preview:
        return preview(task.scene, task.path, task.masks, rig, drawing, effects=chain.effects, seed=seed)

    renderer = renderer or Renderer()
    look = seen_by(renderer)
    drawn_dn = 0.0
    if exact is not None:
        drawn_dn = rendering_error(look, exact).rms_dn
        if drawn_dn > RENDERING_SHARE * tolerance_dn:
            renderer, drawn_dn = exact, 0.0
            look = seen_by(exact)
    tolerance_dn -= drawn_dn
    bounds = {effect.name: effect.bound(look, rig) for effect in chain.effects}
    costs = {effect.name: _seconds(effect, look, len(task.masks)) for effect in chain.effects}
    fixed = {MotionBlur.name, *choice.on, *choice.off}
    left_out = _left_out(bounds, costs, OMISSION_SHARE * tolerance_dn, fixed)
    cheap = _nearly_free(chain, look, bounds, left_out, NEGLIGIBLE_SHARE * tolerance_dn, task.slices)
    left_out -= cheap
    reached = _limits_within_reach(chain, look, bounds, left_out | set(choice.off))
    left_out -= reached
    # In an order, since a set of names has another one in each process, and sums differ in their last bits.
    systematic, noise = total([bounds[name] for name in sorted(left_out)])
    budget = math.sqrt(tolerance_dn**2 - noise**2) - systematic
    kept = [effect for effect in chain.effects if effect.name not in left_out and effect.name not in choice.off]
    kernels = {effect.name: effect for effect in having(kept, KernelEffect)}
    share = KERNEL_SHARE * budget / max(len(kernels), 1)
    cut = {name: _with_reach(effect, look, rig, share) for name, effect in kernels.items()}
    kept = [cut.get(effect.name, effect) for effect in kept]
    spent = KERNEL_SHARE * budget if kernels else 0.0

    blurs = MotionBlur.name not in choice.off
    moving = _as_moved(look, kept, seed)
    sampling = choose_sampling(
        moving, kept, budget - spent, seed=seed, blurs=blurs, slices=task.slices, renderer=renderer
    )
    sampled = [sampling.blur if isinstance(effect, MotionBlur) else effect for effect in kept]
    simulated = tuple(effect for effect in sampled if effect is not None)
    given_up = systematic + spent + (sampling.error_dn if blurs else 0.0)
    reasons = _Reasons(choice, simulated, sampling, reached, cheap)
    return Plan(
        choice.tolerance_dn,
        math.hypot(given_up + drawn_dn, noise),
        simulated,
        tuple(
            reasons.decision(effect, bounds[effect.name], _seconds(effect, look, sampling.views))
            for effect in chain.effects
        ),
        sampling.views,
        sampling.views * look.render_s,
        renderer,
        OMISSION_SHARE * tolerance_dn,
    )


def _left_out(bounds: dict[str, Bound], costs: dict[str, float], limit_dn: float, fixed: Collection[str]) -> set[str]:
    """Choose what to leave out: dearest per DN first, as long as the total stays within the limit."""
    free = [name for name, bound in bounds.items() if name not in fixed and bound.rms_dn <= limit_dn]
    # An effect that changes nothing is worth leaving out however cheap it is.
    free.sort(key=lambda name: bounds[name].rms_dn / (costs[name] + 1e-9))
    chosen: list[str] = []
    for name in free:
        if math.hypot(*total([bounds[other] for other in (*chosen, name)])) <= limit_dn:
            chosen.append(name)
    return set(chosen)


def _nearly_free(
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
    timing = [effect for effect in chain.at(LightStage.TIME) if effect.name not in left_out]

    def uneven(effects: Sequence[Effect]) -> float:
        through = EffectChain(effects, chain.seed, look.rig).through
        return unevenness(through(LightStage.TIME, slices or nominal_slices(look.intervals_s)))

    def cheap(effect: Effect) -> bool:
        if effect.stage is LightStage.TIME:
            return uneven([*timing, effect]) <= uneven(timing) + UNEVEN_MORE
        return (
            effect.stage not in (LightStage.MOTION, LightStage.SCENE) and _seconds(effect, look, masks) <= affordable_s
        )

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
        if effect.stage in (LightStage.CHARGE, LightStage.READOUT) and effect.name not in (*limits_dn, *absent)
    )
    reading_dn = rig.dn_per_e * float(look.most_e.max()) + added_dn
    return {name for name, limit_dn in limits_dn.items() if reading_dn > limit_dn}


def _with_reach(effect: KernelEffect, look: Preview, rig: RigFigures, share_dn: float) -> Effect:
    """Cut the effect's kernel off as near as its share of the tolerance allows."""
    for reach in REACHES:
        if effect.kernel_bound(look, rig, reach).rms_dn <= share_dn:
            break
    return dataclasses.replace(effect, reach=reach)  # type: ignore[type-var]


def _as_moved(look: Preview, kept: Sequence[Effect], seed: int) -> Preview:
    """Return the preview with the motion that the kept effects add to the path's own."""
    chain = EffectChain(kept, seed, look.rig)
    others = tuple(effect for effect in kept if effect.stage is not LightStage.MOTION)
    return dataclasses.replace(look, path=chain.through(LightStage.MOTION, look.path), effects=others)


def _seconds(effect: Effect, look: Preview, views: int) -> float:
    """Predict what an effect costs, from its cost per pixel of its stage's signal."""
    pixels = float(math.prod(look.scene.size))
    count = {LightStage.RADIANCE: views, LightStage.MASKS: len(look.masks), LightStage.PHOTONS: 1 + len(look.masks)}
    return 1e-9 * effect.cost_ns * pixels * count.get(effect.stage, 1)


@dataclass(frozen=True)
class _Reasons:
    """Why an effect is simulated, or left out.

    Args:
        choice: Which effects were forced on or off.
        simulated: Those that are simulated, as sampled.
        sampling: Of the views in time, with its reasons.
        reached: Names of limits that light and noise together may reach.
        cheap: Names of those that could be left out and cost nearly nothing.
    """

    choice: PlanChoice
    simulated: Sequence[Effect]
    sampling: Sampling
    reached: Collection[str]
    cheap: Collection[str]

    def decision(self, effect: Effect, bound: Bound, seconds: float) -> Decision:
        """Say what was decided about one effect, and why; `seconds` is what simulating it costs."""
        kept = next((other for other in self.simulated if other.name == effect.name), None)
        how = ""
        if isinstance(kept, MotionBlur):
            how = self.sampling.how
        elif kept is not None and (kernels := having([kept], KernelEffect)):
            how = f"to {kernels[0].reach:g} sigma"
        why = self._why(effect, bound, kept is not None)
        return Decision(effect.name, bound, kept is not None, why, how, seconds if kept else 0.0)

    def _why(self, effect: Effect, bound: Bound, kept: bool) -> str:
        if effect.name in self.choice.off:
            return "forced off"
        if effect.name in self.choice.on:
            return "forced on"
        if isinstance(effect, MotionBlur):
            return self.sampling.why
        if math.isinf(bound.rms_dn):
            return "cannot be left out"
        if not kept:
            return WITHIN if bound.rms_dn > 0 else IDLE
        if effect.name in self.cheap:
            return CHEAP
        # A limit may be reached by light and noise together where either alone would not.
        return "may be reached" if effect.name in self.reached and bound.rms_dn == 0 else "exceeds its share"

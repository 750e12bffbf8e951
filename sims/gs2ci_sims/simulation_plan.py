"""A plan of a simulation: what is asked for, what was decided about each effect, and how a plan shows itself.

Not here: deciding (`planner`), reading what is asked for from a rig file (`rig_file`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, Effect
from gs2ci_sims.exact import ExactRenderer
from gs2ci_sims.path import CameraPath
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.scene import Scene
from gs2ci_sims.signals import Slices

DEFAULT_TOLERANCE_DN: Final = 0.25
# As many readings as the widest converter has: beyond, every simulation would do.
MOST_TOLERANCE_DN: Final = 2.0**16
# Why an effect is left out that nobody forced off.
WITHIN: Final = "within the tolerance"
IDLE: Final = "changes nothing here"
OMITTED: Final = (WITHIN, IDLE)


@dataclass(frozen=True)
class SimulationTask:
    """An exposure to simulate.

    Args:
        scene: What is seen.
        path: Where the camera is at any time, before effects.
        masks: As nominally shown, [N, H, W].
        rig: The figures.
        effects: All that the rig has.
        seed: The exposure's: effects that shake the camera draw from it.
        slices: When which mask is on show, before effects; as the rig's timing says if not given.
    """

    scene: Scene
    path: CameraPath
    masks: F32
    rig: RigFigures
    effects: Sequence[Effect]
    seed: int = 0
    slices: Slices | None = None


@dataclass(frozen=True)
class PlanChoice:
    """How exactly to simulate.

    Args:
        tolerance_dn: Of the plan in total, DN rms over the pixels, more than 0 and no more than there are readings.
        on: Names of effects to simulate whatever their bounds.
        off: Names of effects to leave out whatever their bounds; they do not count against the tolerance.
    """

    tolerance_dn: float = DEFAULT_TOLERANCE_DN
    on: tuple[str, ...] = ()
    off: tuple[str, ...] = ()

    def check(self, effects: Sequence[Effect]) -> None:
        """Raise unless it can be met by a rig that has these effects.

        Raises:
            InputError: The tolerance is out of range, or a forced effect is not there or forced both ways.
        """
        if not 0 < self.tolerance_dn <= MOST_TOLERANCE_DN:
            raise InputError(
                f"a tolerance of {self.tolerance_dn:g} DN", allowed=f"more than 0, at most {MOST_TOLERANCE_DN:g}"
            )
        known = {effect.name for effect in effects}
        for name in (*self.on, *self.off):
            if name not in known:
                raise InputError(f"no effect {name!r} to force on or off", allowed=", ".join(sorted(known)))
        both = sorted(set(self.on) & set(self.off))
        if both:
            raise InputError(f"effect {both[0]!r} is forced both on and off", remedy="take it off one of the lists")


def total(bounds: Sequence[Bound]) -> tuple[float, float]:
    """Add bounds up: systematic changes, and noises in quadrature; DN rms."""
    systematic = sum(bound.rms_dn for bound in bounds if not bound.random)
    return systematic, math.sqrt(sum(bound.rms_dn**2 for bound in bounds if bound.random))


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
        return math.hypot(*total(list(counted.values())))

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


def _drawn(decided: Plan) -> bytes:
    """Draw the bounds of a plan as bars on a logarithmic scale; what cannot be left out reaches the edge."""
    import io  # noqa: PLC0415  only where somebody looks

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
    figure.savefig(file, format="png")
    return file.getvalue()

"""Gain non-linearity: the reading is not quite proportional to the charge."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, BoundStep, Previewed, Stage, ViewPreview, gain_step
from gs2ci_sims.effects.counts import most_counted_e
from gs2ci_sims.rig import Rig


@dataclass(frozen=True)
class GainNonlinearity:
    """Bend the response by a parabola that is zero at no charge and at the full well W.

    With x = charge / W, the amplifier puts out W (x + 4 d x (1 - x)): d is the largest departure from the straight
    line between the ends, as a share of the full scale. The linearity error LE of EMVA Standard 1288, Release 3.1,
    section 6, is defined similarly, relative to a fitted line.

    Args:
        departure: d, positive for a response that lies above the line, of magnitude below 1/4: it stays monotonic.
    """

    name: ClassVar[str] = "gain_nonlinearity"
    stage: ClassVar[Stage] = Stage.CHARGE
    cost_ns: ClassVar[float] = 10.0
    fixed_pattern: ClassVar[bool] = False

    departure: float

    def __post_init__(self) -> None:
        if not abs(self.departure) < 0.25:
            raise InputError(f"a response that departs by {self.departure} from a line", allowed="less than 0.25")

    def bound(self, scene: Previewed, rig: Rig) -> Bound:
        """The parabola at the charge with its shot noise, its top from half the well on; its slope is 4 d at most."""
        well_e, added_e = rig.sensor.full_well_e, scene.added_e[1]

        def bent_dn(charge_e: F64) -> F64:
            x = np.minimum(charge_e / well_e, 0.5)
            return np.asarray(4 * abs(self.departure) * well_e * x * (1 - x) * rig.dn_per_e)

        likely_e, most_e = scene.charge_e + added_e, scene.most_e + added_e
        likely, most = (bent_dn(np.sqrt(np.square(charge_e) + charge_e)) for charge_e in (likely_e, most_e))
        error_dn = 4 * abs(self.departure) * rig.dn_per_e * scene.charge_error_e
        likely_dn, most_dn = (float(np.sqrt(np.square(bent).mean())) for bent in (likely, most))
        return Bound(min(likely_dn + error_dn, most_dn), float(bent_dn(most_counted_e(most_e)).max())).by(
            "min(v + u, top)",
            BoundStep("D", self.departure, "", "largest departure from a line, of full scale"),
            gain_step(rig),
            BoundStep("e", scene.charge_error_e, "e", "by what the charge may differ from the previewed, rms"),
            BoundStep("v", likely_dn, "DN", "4 D W x (1 - x) K at the previewed charge x W, rms over the pixels"),
            BoundStep(
                "u", error_dn, "DN", "the same of what it may differ by, at the steepest slope", "4 * abs(D) * K * e"
            ),
            BoundStep("top", most_dn, "DN", "the same at the charge that no pixel exceeds"),
        )

    def brightest(self, scene: ViewPreview) -> float:
        """The steepest slope: it is the factor by which a change of the light before the amplifier grows."""
        return 1 + 4 * abs(self.departure)

    def apply(self, signal: F64, rig: Rig, rng: np.random.Generator) -> F64:
        """Bend electrons [H, W, C]; beyond the ends the response continues without the parabola."""
        x = np.clip(signal / rig.sensor.full_well_e, 0.0, 1.0)
        return signal + 4 * self.departure * rig.sensor.full_well_e * x * (1 - x)

"""The calibration steps, in the order in which `all` runs them: one line each.

Not here: the steps.
"""

from collections.abc import Callable
from typing import Final

from gs2ci_calibration import dark_flat, photon_transfer, timing
from gs2ci_calibration.bench import Bench
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Section
from gs2ci_calibration.geometry.camera import measure_camera
from gs2ci_calibration.geometry.stage import measure_stage
from gs2ci_calibration.masks.masks_step import measure_masks
from gs2ci_calibration.masks.registration_step import measure_registration

Procedure = Callable[[Bench, Bundle], Section]

PROCEDURES: Final[dict[str, Procedure]] = {
    # In this order, because a step may need the sections of earlier ones.
    "dark-flat": dark_flat.measure,
    "sensor": photon_transfer.measure,
    "registration": measure_registration,
    "masks": measure_masks,
    "camera": measure_camera,
    "stage": measure_stage,
    "timing": timing.measure,
}
"""Name on the command line -> the function that measures that section."""

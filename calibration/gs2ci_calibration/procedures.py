"""Which calibration steps there are, in the order in which `all` runs them: one line each.

Not here: the steps. `gs2ci.commands.calibrate` and tests import this file.
"""

from collections.abc import Callable
from typing import Final

from gs2ci_calibration.bench import Bench
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Section
from gs2ci_calibration.geometry.camera import measure_camera
from gs2ci_calibration.geometry.stage import measure_stage

Procedure = Callable[[Bench, Bundle], Section]

PROCEDURES: Final[dict[str, Procedure]] = {
    "camera": measure_camera,
    "stage": measure_stage,
}
"""Name on the command line -> the function that measures that section."""

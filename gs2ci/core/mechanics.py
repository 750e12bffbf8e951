"""What lies between the counted and the true position of a simulated axis, as a rig file states it.

Here: the record. Not here: what it does to a motion (`gs2ci_sims.axis_motion`).
"""

from typing import Annotated

from pydantic import Field

from gs2ci.core.config import ConfigTable, NotNegative, Positive


class Mechanics(ConfigTable):
    """[world.mechanics.AXIS]; the default is a perfect axis."""

    scale: Positive = 1.0
    """True distance per counted distance."""
    backlash_mm: NotNegative = 0.0
    """Lost motion at a reversal."""
    lag_s: NotNegative = 0.0
    """Delay of the carriage behind the controller."""
    ripple_mm: NotNegative = 0.0
    """Amplitude of the screw's periodic error."""
    pitch_mm: Positive = 1.0
    """Its period."""
    reversed_sign: bool = False
    """Whether the carriage moves the other way."""
    speed_error: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    """Relative error of its speed."""
    repeatability_mm: NotNegative = 0.0
    """Standard deviation of where a move truly ends; the next move forgets it."""
    slip_mm: NotNegative = 0.0
    """What a move may lose for good in a slipping coupling, at most; evenly distributed."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of the draws of repeatability and slip."""

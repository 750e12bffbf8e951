"""Why a calibration is refused: one error, and the list of reasons that tests and users can tell apart.

A procedure that cannot trust what it sees raises `CalibrationError` with the reason, what was seen, what would be good
enough and what to do; nothing is then written. Not here: any test of goodness (the procedures).
"""

from enum import Enum, unique

from gs2ci.core.errors import Gs2ciError


@unique
class Reason(Enum):
    """What is wrong with the bench, or with what was asked."""

    NO_LIGHT = "no light"
    """The flat field is as dark as the dark frames: lens cap on, lamp off, no path through the modulator."""
    NOT_DARK = "not dark"
    """Light comes in during dark frames: the lens cap is not on."""
    CLIPPED_AT_BLACK = "clipped at black"
    """Dark readings are 0: the black level is too low to show the noise."""
    SATURATED = "saturated"
    """Readings are clipped at the shortest exposure that can be used."""
    LAMP_FLICKERS = "lamp flickers"
    """The light differs from frame to frame by more than its own noise explains."""
    LAMP_DRIFTS = "lamp drifts"
    """The light changed over the procedure by more than references can follow."""
    UNEVEN = "field uneven"
    """The flat field falls off, or has structure, by more than can be divided out."""
    TOO_FEW_FRAMES = "too few frames"
    NO_VARIANCE = "no variance"
    """Frames do not differ from each other: not live readings of a sensor."""
    DEAD_PIXELS = "dead pixels"
    """More pixels, rows or columns do not answer to light than can be worked round."""
    NOT_LINEAR = "not linear"
    """Readings do not follow the exposure."""
    NO_LATENCY = "no edge found"
    """The sweep of the delay does not cross the edge of the exposure."""
    LOW_CONTRAST = "low contrast"
    """On and off differ by too little to divide by their difference."""
    WRONG_ORDER = "masks in the wrong order"
    WRONG_POLARITY = "modulator inverted"
    """Open elements are dark and closed ones are light."""
    FLIPPED = "modulator flipped"
    """The modulator's image is mirrored or turned against what the rig file says."""
    NOT_REGISTERED = "modulator not found"
    """No map from modulator to sensor explains the pictures."""
    MISPREDICTED = "held-out mask mispredicted"
    BOARD_NOT_SEEN = "board not seen"
    BLURRED = "out of focus"
    """Edges are too wide: the camera's figures would be others after focusing."""
    DEGENERATE_VIEWS = "board views degenerate"
    """Too few views, or corners on one line: the camera cannot be told from them."""
    BAD_FIT = "bad fit"
    """A fit leaves residuals far above its noise."""
    STAGE_STILL = "stage does not move"
    STAGE_SLIPS = "stage slips"
    STAGE_WRONG_WAY = "stage goes the wrong way"
    """An axis moves the camera in another direction, or by another distance, than the rig file says."""
    NO_STAGE = "no stage"
    NEEDS = "earlier step missing"
    """A section of the bundle that this step builds on is not there."""
    DOES_NOT_FIT = "bundle does not fit"
    """The bundle belongs to other devices, another mode, exposure or time, or the bench has drifted since."""


class CalibrationError(Gs2ciError):
    """A calibration step refuses what it sees; nothing of it was written.

    Args:
        step: Name of the step, as on the command line ("masks").
        reason: Which of the reasons.
        problem: What was seen, with figures.
        allowed: What would be good enough.
        remedy: What to do about it.
    """

    def __init__(self, step: str, reason: Reason, problem: str, *, allowed: str = "", remedy: str = "") -> None:
        super().__init__(f"{step}: {reason.value}: {problem}", allowed=allowed, remedy=remedy)
        self.step = step
        self.reason = reason

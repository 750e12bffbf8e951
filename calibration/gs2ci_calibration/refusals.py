"""Why a calibration is refused: one error, and the list of reasons that tests and users can distinguish.

A procedure that cannot trust its frames raises `CalibrationError` with the reason, what was seen, what would be good
enough and what to do; nothing is written then. Not here: the tests of quality (the procedures).
"""

from enum import Enum

from gs2ci.core.errors import Gs2ciError


class Reason(Enum):
    """What is wrong with the bench, or with the request."""

    NO_LIGHT = "no light"
    """The flat field is as dark as the dark frames: lens cap on, lamp off, no path through the modulator."""
    NOT_DARK = "not dark"
    """Light reaches the sensor during dark frames: the lens cap is not on."""
    CLIPPED_AT_BLACK = "clipped at black"
    """Dark readings are 0: the black level is too low to show the noise."""
    SATURATED = "saturated"
    """Readings are clipped at the shortest exposure that can be used."""
    LAMP_FLICKERS = "lamp flickers"
    """The light differs from frame to frame by more than its own noise explains."""
    LAMP_DRIFTS = "lamp drifts"
    """The light changed during the procedure by more than references can correct."""
    UNEVEN = "field uneven"
    """The flat field falls off, or has structure, by more than a division can correct."""
    TOO_FEW_FRAMES = "too few frames"
    NO_VARIANCE = "no variance"
    """Frames do not differ from each other: they are no live readings of a sensor."""
    DEAD_PIXELS = "dead pixels"
    """Too many pixels, rows or columns do not respond to light."""
    NOT_LINEAR = "not linear"
    """Readings do not follow the exposure."""
    NO_LATENCY = "no edge found"
    """The sweep of the delay does not cross the edge of the exposure."""
    LOW_CONTRAST = "low contrast"
    """On and off differ too little to divide by their difference."""
    WRONG_ORDER = "masks in the wrong order"
    WRONG_POLARITY = "modulator inverted"
    """Open elements are dark and closed ones are light."""
    FLIPPED = "modulator flipped"
    """The modulator's image is mirrored or rotated relative to the orientation in the rig file."""
    NOT_REGISTERED = "modulator not found"
    """No map from modulator to sensor explains the pictures."""
    MISPREDICTED = "held-out mask mispredicted"
    BOARD_NOT_SEEN = "board not seen"
    BLURRED = "out of focus"
    """Edges are too wide: focusing would change the camera's intrinsics."""
    DEGENERATE_VIEWS = "board views degenerate"
    """Too few views, or corners on one line: the camera cannot be estimated from them."""
    BAD_FIT = "bad fit"
    """The residuals of a fit are far above the noise."""
    STAGE_STILL = "stage does not move"
    STAGE_SLIPS = "stage slips"
    STAGE_WRONG_WAY = "stage goes the wrong way"
    """An axis moves the camera in another direction, or by another distance, than the rig file says."""
    NO_STAGE = "no stage"
    NEEDS = "earlier step missing"
    """A section of the bundle that this step needs is missing."""
    DOES_NOT_FIT = "bundle does not fit"
    """The bundle belongs to other devices, another mode, exposure or time, or the bench has drifted since."""


class CalibrationError(Gs2ciError):
    """A calibration step refuses its frames or the bundle; nothing of it was written.

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

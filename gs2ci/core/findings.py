"""Everything that a reconstruction may report: one code, one sentence and one remedy for each finding.

Here: the register, `Code`, and `Finding`, one of its entries with its figures. The texts of the codes are in the files
of `sentences/`, by topic, one table per code. Records contain findings; pages, the overview, the terminal and tests
read their codes. `docs/findings.md` lists them all (`python -m tests.docs`). Not here: errors, which end a command
(`gs2ci.core.errors`).
"""

import string
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum, auto
from functools import cache
from pathlib import Path
from typing import Any, Final

Figure = float | int | str | list[int]

TOPICS: Final = ("devices", "fits", "measurement", "geometry", "sources", "result", "exposures")
"""Files of `sentences/`."""


class Weight(StrEnum):
    """How much a finding matters."""

    REMARK = "remark"
    """Worth knowing; needs no action, though the remedy may help."""
    DOUBT = "doubt"
    """Part of the result is not reliable, or less reliable than usual."""
    FAILURE = "failure"
    """Something that was requested could not be done, and the result lacks it."""


REMARK, DOUBT, FAILURE = Weight.REMARK, Weight.DOUBT, Weight.FAILURE


@dataclass(frozen=True)
class Text:
    """The text of a code.

    Args:
        weight: How much it matters.
        sentence: The sentence, with the names of its figures in braces.
        remedy: What can be done about it.
    """

    weight: Weight
    sentence: str
    remedy: str


@cache
def texts() -> dict[str, Text]:
    """Read the texts of all codes."""
    shared = _table("shared")
    rows = {code: row for topic in TOPICS for code, row in _table(topic).items()}
    return {
        code: Text(Weight(row["weight"]), row["sentence"], string.Template(row["remedy"]).substitute(shared))
        for code, row in rows.items()
    }


def _table(topic: str) -> dict[str, Any]:
    return tomllib.loads((Path(__file__).parent / "sentences" / f"{topic}.toml").read_text(encoding="utf-8"))


class Code(StrEnum):
    """A kind of finding."""

    @property
    def weight(self) -> Weight:
        """Get how much it matters."""
        return texts()[self].weight

    @property
    def sentence(self) -> str:
        """Get the sentence, with the names of its figures in braces."""
        return texts()[self].sentence

    @property
    def remedy(self) -> str:
        """Get what can be done about it."""
        return texts()[self].remedy

    @property
    def figures(self) -> frozenset[str]:
        """Get the names of the figures in the sentence."""
        return frozenset(name for _, name, _, _ in string.Formatter().parse(self.sentence) if name)

    # Which device rendered.
    GPU_USED = auto()
    GPU_EXTRA_MISSING = auto()
    GPU_DRIVER_SILENT = auto()
    GPU_DRIVER_OLD = auto()
    GPU_NOT_THERE = auto()
    GPU_TOO_OLD = auto()
    GPU_MEMORY_SMALL = auto()
    GPU_FAILS = auto()
    GPU_DIFFERS = auto()
    GPU_NOT_CAPTURED = auto()

    # What a budget allows.
    TIME_DIVIDED = auto()
    TIME_TOO_SHORT = auto()

    # Why a fit ended.
    FIT_STALLED = auto()
    FIT_ALL_DONE = auto()
    FIT_ALL_DONE_UNJUDGED = auto()
    FIT_TIME_UP = auto()
    FIT_TIME_UP_UNJUDGED = auto()
    FIT_INTERRUPTED = auto()
    INTERRUPTED = auto()
    FIT_DIVERGED = auto()
    FIT_BEHIND = auto()

    # The light of the measurement.
    EMPTY_MEASUREMENT = auto()
    SATURATED = auto()
    UNTOLD_CLIPPING = auto()
    READINGS_BEND = auto()
    UNIT_CORRECTED = auto()

    # Errors of the masks that the measurement shows.
    MASKS_TURNED = auto()
    MASKS_BEGIN_ELSEWHERE = auto()
    MASKS_CORRECTED = auto()
    MASKS_TOO_SOFT = auto()
    MASKS_AS_DRAWN = auto()
    MASKS_DIVIDED = auto()
    RIM_GUESSED = auto()
    DARKER_THAN_DARK = auto()
    BRIGHTER_THAN_WHITE = auto()
    LAMP_IN_PICTURE = auto()
    OTHER_MOSAIC = auto()
    VERY_DARK = auto()
    UNEVEN_VIEWS = auto()
    WEIGHTS_CORRECTED = auto()
    LIGHT_AS_SEEN = auto()

    MASKS_HAVE_MOMENTS = auto()
    MASKS_BLUR = auto()
    VIEWS_SMEARED = auto()

    # The masks.
    SINGLE_VIEW = auto()
    UNLIT_VIEWS = auto()
    FAINT_VIEWS = auto()
    SAME_MASKS = auto()
    MASKS_REPEATED = auto()
    MASKS_DIFFER_LITTLE = auto()
    MASKS_IN_PAIRS = auto()
    UNOPENED_PIXELS = auto()
    MOSTLY_UNOPENED = auto()

    # The sensor.
    DEAD_LINES = auto()
    STUCK_BORDER_LINES = auto()
    HOT_PIXELS = auto()

    # The focal length.
    FOCAL_ASSUMED = auto()
    FOCAL_ESTIMATED = auto()
    FOCAL_OF_CAMERA_FILE = auto()
    FOCAL_OF_SHOT = auto()
    FOCAL_CHANGED = auto()

    # Tracked points, and the motion estimated from them.
    FEW_TRACKS = auto()
    CLUSTERED_TRACKS = auto()
    FEW_VIEWS_TRACKED = auto()
    UNREGISTERED_VIEWS = auto()
    CAMERA_STOOD_STILL = auto()
    CAMERA_GIVEN_AT_REST = auto()
    CAMERA_ONLY_TURNED = auto()
    PARALLAX_MAY_DROWN = auto()
    FEW_TRACKS_EXPLAINED = auto()
    TRACKS_BADLY_EXPLAINED = auto()
    POINTS_BEHIND_CAMERA = auto()
    TURN_TOO_LARGE = auto()
    PATH_UNCERTAIN = auto()
    PATH_UNCONFIRMED = auto()
    CENTRE_MAY_MOVE = auto()
    POSES_INTERPOLATED = auto()
    DEPTH_STARTS_AS_PLANE = auto()
    ATTEMPTS_RANKED = auto()

    # Things that move.
    SCENE_MOVES = auto()
    MOTION_SMALL = auto()
    MOTION_AROUND = auto()
    MOTION_OR_CAMERA = auto()
    MOTION_NOT_TAKEN = auto()
    SCENE_NOT_FOLLOWING = auto()
    VIEWS_POLISHED = auto()

    # Depth order.
    DEPTH_ORDER_OPEN = auto()
    DEPTH_IN_NOISE = auto()

    # Which source the first path came from.
    SOURCE_CHOSEN = auto()
    SOURCE_FAILED = auto()
    STAGE_NOT_TAKEN = auto()
    STAGE_SIGN_CONTRADICTED = auto()
    STAGE_MOTION_UNSEEN = auto()
    POSES_NOT_BORNE_OUT = auto()
    POSES_NOT_TAKEN = auto()
    POSES_UNCHECKED = auto()
    POSES_CONTRADICTED = auto()
    POSES_MOVED = auto()
    DEPTH_RANGE_FOUND = auto()
    WIDE_MOTION = auto()
    PATH_BY_DISPLACEMENTS = auto()
    PATH_FOUND_AGAIN = auto()
    PATH_FOUND_IN_FIT = auto()
    PROXIES_CHOSEN = auto()

    # VGGT, where the user has added it.
    TRACKS_FOR_VGGT = auto()
    VGGT_POSES_TAKEN = auto()
    VGGT_DEPTH_TAKEN = auto()
    VGGT_FOCAL_TAKEN = auto()
    VGGT_FOCAL_DIFFERS = auto()
    VGGT_FOCAL_REFUSED = auto()

    # The fits.
    ROLLED_BACK_NOT_FINITE = auto()
    ROLLED_BACK_EXPLODED = auto()
    OF_ANOTHER_FIT = auto()
    FITS_MISSING = auto()
    MEAN_REFUSED = auto()
    FINE_HELPED = auto()
    FINE_UNJUDGED = auto()
    STAND_IN = auto()
    FINE_UNCHANGED = auto()
    FINE_LEFT_OUT = auto()

    # Several exposures.
    EXPOSURES_TOGETHER = auto()
    EXPOSURE_LEFT_OUT = auto()
    EXPOSURE_PLACED_OTHERWISE = auto()
    EXPOSURES_REPEAT = auto()
    EXPOSURES_REPEAT_MASKS = auto()
    OF_EXPOSURE = auto()

    # The result.
    VIEWS_COMBINED = auto()
    VIEWS_OF_PATCHES = auto()
    UNJUDGED = auto()
    LITTLE_EXPLAINED = auto()
    VIEWS_ERR = auto()
    DECODE_KEPT = auto()
    DECODE_HURRIED = auto()
    DECODE_OUT_OF_TIME = auto()

    # Comparison with a truth, or with another measurement.
    TRUE_PATH_STRAIGHT = auto()
    TRUE_PATH_REVERSED = auto()
    TRUE_PATH_CONTRADICTED = auto()
    TRUE_PATH_STILL = auto()
    OTHER_SCALE = auto()
    OTHER_MASKS = auto()
    PROXIES_BY_ENERGY = auto()


@dataclass(frozen=True)
class Finding:
    """Something found in one run. Make it with `finding`, which writes its sentence.

    Args:
        code: Its kind.
        sentence: The sentence with its figures.
        figures: The figures, by name.
    """

    code: Code
    sentence: str
    figures: Mapping[str, Figure] = field(default_factory=dict)

    @property
    def kind(self) -> Code:
        """Get its code; of one exposure of several, that of what was found in it."""
        return Code(str(self.figures["code"])) if self.code is Code.OF_EXPOSURE else self.code

    @property
    def advice(self) -> str:
        """Get the sentence, followed by the remedy if it is a doubt or a failure."""
        return self.sentence if self.kind.weight is REMARK else f"{self.sentence} {self.kind.remedy}"


Findings = tuple[Finding, ...]


def finding(code: Code, /, **figures: Figure) -> Finding:
    """Make a finding, and write its sentence.

    Args:
        code: Its kind.
        figures: All figures that its sentence names.

    Raises:
        KeyError: A figure is missing.
    """
    return Finding(code, code.sentence.format(**figures), figures)

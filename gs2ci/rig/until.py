"""When a capture has taken enough exposures: by the standard errors of what they give together, or by time.

After some of the exposures all that were taken are reconstructed together, by the preset `draft`, and the standard
errors of its views or depths are compared with what is asked. The bench waits meanwhile, dark and at rest; what was
taken is in the file. Here: what can be asked, and the judgement. Not here: the capture (`recording`), the
reconstruction (`gs2ci.reconstruct.exposures.joint`) and its standard errors (`gs2ci.reconstruct.uncertainty`).
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, Protocol

import numpy as np

from gs2ci.core.durations import parse_duration_s, spoken_duration
from gs2ci.core.errors import Gs2ciError, InputError
from gs2ci.core.findings import Code
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.rig.session import SessionLog
from gs2ci_drivers.plan import CapturePlan, Mode

Kind = Literal["views", "depth", "time"]

MOST: Final = 32
"""Exposures that a capture takes at most, unless `--shots` says otherwise."""
# The step from one judgement to the next, as a share of the exposures: noise falls with the root of their number, and
# a reconstruction takes longer than an exposure.
_STEP: Final = 1.25
_VIEWS: Final = re.compile(r"(\d+(?:\.\d*)?)\s*dB", re.IGNORECASE)
_DEPTH: Final = re.compile(r"depth\s*(\d+(?:\.\d*)?)\s*%", re.IGNORECASE)
_ALLOWED: Final = (
    "an accuracy of the views, as 35dB (5 to 80), of depth, as 'depth 1%' (0.01 to 50), or a duration, as 10min"
)
_LEAST_SQUARE: Final = 1e-12
_RANGES: Final[dict[Kind, tuple[float, float]]] = {"views": (5.0, 80.0), "depth": (0.01, 50.0)}


@dataclass(frozen=True)
class CaptureTarget:
    """What is asked of a capture.

    Args:
        kind: Of what.
        value: Peak signal-to-noise ratio of the views, dB; standard error of depth in the median, %; duration, s.
    """

    kind: Kind
    value: float

    @classmethod
    def parse(cls, text: str) -> "CaptureTarget":
        """Read a target as users type it.

        Raises:
            InputError: It is none, or outside what any capture could reach.
        """
        wanted = text.strip()
        for kind, form in (("views", _VIEWS), ("depth", _DEPTH)):
            if found := form.fullmatch(wanted):
                return cls._within(kind, float(found.group(1)), text)  # type: ignore[arg-type]
        try:
            # A bare number could be of anything.
            if not wanted[-1:].isalpha():
                raise InputError("a number without its unit")
            return cls("time", parse_duration_s(wanted))
        except InputError as error:
            raise InputError(f"--until {text!r}", allowed=_ALLOWED) from error

    @classmethod
    def _within(cls, kind: Kind, value: float, text: str) -> "CaptureTarget":
        least, most = _RANGES[kind]
        if not least <= value <= most:
            raise InputError(f"--until {text!r}", allowed=_ALLOWED)
        return cls(kind, value)

    def figure(self, result: RunResult) -> float | None:
        """Return what the standard errors of a result say of what is asked; None if they say nothing of it."""
        errors = result.uncertainty
        if errors is None:
            return None
        if self.kind == "views":
            mean_square = float(np.mean(np.square(errors.views, dtype=np.float64)))
            # What held-out pixels say against the views counts as well, if it is more.
            told = (note.figures["share"] for note in result.notes if note.kind is Code.VIEWS_ERR)
            mean_square = max([mean_square, *(share * share for share in told if isinstance(share, float))])
            return -10 * float(np.log10(max(mean_square, _LEAST_SQUARE)))
        if result.depth is None or errors.depth is None:
            return None
        known = (result.depth > 0) & (errors.depth > 0)
        return 100 * float(np.median(errors.depth[known] / result.depth[known])) if known.any() else None

    def reached(self, figure: float) -> bool:
        """Tell whether a figure is enough."""
        return figure <= self.value if self.kind == "depth" else figure >= self.value

    def said(self, figure: float) -> str:
        """Write a figure for a sentence."""
        if self.kind == "time":
            return spoken_duration(figure)
        return f"{figure:.1f} dB" if self.kind == "views" else f"depth {figure:.2g} %"


def check_judged(plan: CapturePlan) -> None:
    """Check that a capture's exposures can be judged one after another.

    Raises:
        InputError: Its frames are of single masks, or it takes all of them in one run.
    """
    settings = plan.settings
    if settings.mode is Mode.PER_MASK or settings.continuous:
        raise InputError(
            f"--until with {'mode = ' + repr(settings.mode.value) if not settings.continuous else 'continuous = true'}",
            allowed="coded exposures that are taken one after another",
            remedy="change [capture] of the rig file, or give their number by --shots",
        )


class Shots(Protocol):
    """The exposures taken so far: a shot file that is being written."""

    @property
    def rows_written(self) -> int:
        """Get their number."""

    def shot(self, row: int) -> Shot:
        """Return one of them."""


Solve = Callable[[Sequence[Shot]], RunResult]
"""Reconstructs exposures together, with standard errors."""


@dataclass
class Until:
    """Whether the exposures taken so far are enough.

    Args:
        target: What is asked.
        most: Exposures that are taken at most.
        now_s: The clock of the bench; a time counts from here on.
        say: Told each judgement, in a sentence.
        solve: Reconstructs exposures together.
    """

    target: CaptureTarget
    most: int
    now_s: Callable[[], float]
    say: Callable[[str], object]
    solve: Solve
    _began_s: float = field(default=0.0, init=False)
    _judged: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._began_s = self.now_s()

    def __call__(self, taken: Shots, log: SessionLog) -> bool:
        """Judge after an exposure, if it is time to; the judgement is said, and noted in the session log."""
        count = taken.rows_written
        if not self._is_due(count):
            return False
        figure, problem = self._figure(taken)
        enough = figure is not None and self.target.reached(figure)
        asked = self.target.said(self.target.value)
        found = problem if figure is None else self.target.said(figure)
        more = "" if enough or count < self.most else "; no more are taken than --shots allows"
        if self.target.kind != "time" or enough or more:
            self.say(f"{_exposures(count)}: {found}, asked for {asked}{more}")
        log.note("judged", exposures=count, figure=figure, problem=problem, asked=asked, enough=enough)
        return enough

    def _is_due(self, count: int) -> bool:
        """Tell whether as many exposures are judged: each of the first four, then every quarter more, and the last."""
        if self.target.kind != "time" and count < self.most and count < max(self._judged + 1, self._judged * _STEP):
            return False
        self._judged = count
        return True

    def _figure(self, taken: Shots) -> tuple[float | None, str]:
        """Return the figure of all exposures; or None and why there is none. What fails here ends no capture."""
        if self.target.kind == "time":
            return self.now_s() - self._began_s, ""
        try:
            figure = self.target.figure(self.solve([taken.shot(row) for row in range(taken.rows_written)]))
        except Gs2ciError as error:
            return None, error.problem
        return figure, f"they give no standard error of {self.target.kind}" if figure is None else ""


def _exposures(count: int) -> str:
    return "1 exposure" if count == 1 else f"{count} exposures together"


def solve_together(shots: Sequence[Shot]) -> RunResult:
    """Reconstruct exposures together by the preset `draft`.

    Raises:
        Gs2ciError: They cannot be reconstructed together.
    """
    from gs2ci.reconstruct.exposures.joint import reconstruct_together  # noqa: PLC0415  torch, only if asked for
    from gs2ci.reconstruct.presets.named import preset  # noqa: PLC0415  as above

    return reconstruct_together(shots, preset("draft")).result

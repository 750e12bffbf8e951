"""The running stage of a long computation, common to all displays, and the words for its figures.

Here: `RunningStage`; `StageDisplay`, the base class of displays; `describe_figures`. Not here: any drawing.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Final, Self

from gs2ci.core.clock import Clock, WallClock
from gs2ci.core.errors import InputError

# At this rate redrawing costs the fit about 0.1 %, and the display looks smooth.
REDRAWS_PER_SECOND: Final = 4

_LABELS: Final = {"heldout": "held-out", "psnr": "PSNR"}
# Suffixes of the names of figures, as everywhere in the code, and how their units are written.
_UNITS: Final = {"db": "dB", "dn": "DN", "ms": "ms", "us": "µs", "px": "px"}


@dataclass
class RunningStage:
    """A stage that runs or has ended.

    Args:
        name: Its name.
        began_s: When it began, by the display's clock.
        total: Number of its steps; None while that is not known.
        done: Number of finished steps.
        figures: The latest figures, in words.
        took_s: Its duration after it has ended.
    """

    name: str
    began_s: float
    total: int | None = None
    done: int = 0
    figures: str = ""
    took_s: float | None = None

    def move(self, done: int, figures: str) -> None:
        """Record the progress."""
        self.done, self.figures = done, figures or self.figures

    def end(self, now_s: float) -> None:
        """Record its end; if it converged before its last step, the steps done become its total."""
        self.took_s, self.total = now_s - self.began_s, self.done or self.total

    def seconds(self, now_s: float) -> float:
        """Return how long it has taken."""
        return now_s - self.began_s if self.took_s is None else self.took_s


class StageDisplay(ABC):
    """A progress listener that is opened, and closed when the work ends or fails.

    It keeps the running stage; its subclasses draw it.

    Args:
        clock: For the durations of stages; wall-clock time if None.
    """

    def __init__(self, clock: Clock | None = None) -> None:
        self._clock = clock or WallClock()
        self._running: RunningStage | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.finish()

    def stage(self, name: str, total: int | None = None) -> None:
        """End the last stage; begin another."""
        self.finish()
        self._running = RunningStage(name, self._clock.now_s(), total)
        self._changed()

    def expect(self, total: int) -> None:
        """Change the stage's number of steps."""
        if self._running is not None:
            self._running.total = total

    def step(self, done: int, **figures: float | int | str) -> None:
        """Record the progress of the stage, and the latest figures."""
        if self._running is not None:
            self._running.move(done, describe_figures(figures))
            self._changed()

    @abstractmethod
    def say(self, text: str) -> None:
        """Show the sentence."""

    def ask(self, request: str) -> None:
        """Show what a person is to do, and wait for Enter.

        Raises:
            InputError: Standard input has ended, so that Enter cannot be pressed.
        """
        self.say(f"{request}, then press Enter")
        wait_for_enter(request)

    def finish(self) -> None:
        """End the running stage: work until the next one begins does not belong to it."""
        stage, self._running = self._running, None
        if stage is not None:
            self._ended(stage)

    def _changed(self) -> None:
        """Draw the running stage, if the output can be redrawn."""
        return

    def _ended(self, stage: RunningStage) -> None:
        """Show a stage that is over."""
        return


def wait_for_enter(request: str) -> None:
    """Wait until the user has done what was requested.

    Raises:
        InputError: Standard input has ended.
    """
    try:
        input()
    except EOFError as error:
        raise InputError(f"{request}: nobody is there to press Enter", remedy="run it at a terminal") from error


def describe_figures(figures: dict[str, Any]) -> str:
    """Put figures in a row: `loss 0.0123 · held-out 0.0210 · 13 000 Gaussians`."""
    return " · ".join(_describe_figure(name, value) for name, value in figures.items())


def _describe_figure(name: str, value: float | str) -> str:
    stem, _, ending = name.rpartition("_")
    unit = _UNITS.get(ending, "")
    stem = stem if unit else name
    label = _LABELS.get(stem, stem.replace("_", " "))
    if isinstance(value, str):
        return f"{label} {value}"
    if name == "gaussians":
        return f"{value:,} Gaussians".replace(",", " ")
    return f"{label} {_number(value, 2 if unit else 4)} {unit}".rstrip()


def _number(value: float, decimals: int) -> str:
    """Write a running figure; fixed decimals keep it from jumping about."""
    if isinstance(value, int):
        return str(value)
    if 100 <= abs(value) < 1e7:
        return f"{value:.0f}"
    return f"{value:.{decimals}f}" if 10.0 ** (1 - decimals) <= abs(value) < 100 else f"{value:.3g}"

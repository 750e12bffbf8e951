"""What a person sees of a long computation: at a terminal, in a notebook, in a file; and the closing table of a run.

Here: the listeners that implement `gs2ci.core.progress.Progress`: one draws on a terminal, one below a notebook's cell,
one writes plain lines where output goes to a file or a pipe, one keeps quiet; the choice between them; and
`print_summary`. Not here: any figure's computation.
"""

import html
import os
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Protocol, Self

from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.table import Table
from rich.text import Text

from gs2ci.core import progress
from gs2ci.core.clock import Clock, WallClock
from gs2ci.core.durations import spoken_duration
from gs2ci.core.errors import InputError

if TYPE_CHECKING:
    from gs2ci.evaluate.report import Report, Trajectory

# Redrawing costs the fit about a thousandth at this rate; an eye needs no more.
REDRAWS_PER_SECOND: Final = 4
# Set by `gs2ci --quiet`, for whatever is started from there as well.
QUIET_VARIABLE: Final = "GS2CI_QUIET"
STAGE_WIDTH: Final = 12

_LABELS: Final = {"heldout": "held-out", "psnr": "PSNR"}
# How names of figures end, as everywhere in the code, and how the unit is written.
_UNITS: Final = {"db": "dB", "dn": "DN", "ms": "ms", "us": "µs", "px": "px"}


class Display(progress.Progress, Protocol):
    """A progress listener that is opened, and closed when the work ends or fails."""

    def ask(self, request: str) -> None:
        """Show what a person is to do, and wait for Enter.

        Raises:
            InputError: Standard input has ended: nobody will press it.
        """
        ...

    def finish(self) -> None:
        """End the running stage: what is done until the next one begins is no part of it."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def open_display(console: Console | None = None) -> Display:
    """Choose the display for where output goes: live on a terminal, a bar in a notebook, plain lines elsewhere.

    Args:
        console: Where to show; standard output if None.
    """
    if is_quiet():
        return QuietDisplay(console or Console(stderr=True, highlight=False))
    if console is None and in_notebook():
        return NotebookDisplay()
    console = console or Console(highlight=False)
    return LiveDisplay(console) if console.is_terminal else PlainDisplay(console)


def is_quiet() -> bool:
    """Tell whether the user asked for silence, by `--quiet` or by the variable GS2CI_QUIET."""
    return os.environ.get(QUIET_VARIABLE, "") not in ("", "0")


def in_notebook() -> bool:
    """Tell whether this process is a notebook's kernel, whose cells show HTML."""
    # Whoever has not imported IPython by now is not called from it.
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and hasattr(shell, "kernel")


@contextmanager
def shown(progress: progress.Progress | None) -> Iterator[Display]:
    """Give a listener to work with: the caller's own, which stays open, or a display that is closed at the end."""
    if progress is not None:
        yield _Caller(progress)
        return
    with open_display() as display:
        yield display


@contextmanager
def interrupted_within() -> Iterator[None]:
    """Raise KeyboardInterrupt for an interruption that compiled code has turned into another error.

    Raises:
        KeyboardInterrupt: The user interrupted.
    """
    try:
        yield
    except SystemError as error:
        if stems_from_interruption(error):
            raise KeyboardInterrupt from error
        raise


def stems_from_interruption(error: BaseException | None) -> bool:
    """Tell whether Ctrl-C came while compiled code was being entered: Numba makes it the cause of another error."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


class _Caller:
    """A caller's own listener as a display: what it does not know is left out."""

    def __init__(self, listener: progress.Progress) -> None:
        self._listener = listener
        self.stage, self.expect, self.step, self.say = listener.stage, listener.expect, listener.step, listener.say

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def ask(self, request: str) -> None:
        """Ask through the listener where it can, else by a sentence and Enter."""
        own: Callable[[str], None] | None = getattr(self._listener, "ask", None)
        if own is not None:
            own(request)
            return
        self.say(f"{request}, then press Enter")
        _wait_for_enter(request)

    def finish(self) -> None:
        """End the running stage where the listener can."""
        own: Callable[[], None] | None = getattr(self._listener, "finish", None)
        if own is not None:
            own()


class QuietDisplay(progress.Silent):
    """Nothing but what a person has to do."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def ask(self, request: str) -> None:
        """Write the request and wait for Enter."""
        self._console.print(f"{request}, then press Enter", markup=False, highlight=False, soft_wrap=True)
        _wait_for_enter(request)

    def finish(self) -> None:
        """Ignore."""


class _StageDisplay(ABC):
    """What displays of their own making remember of the running stage; the name is empty where none is running."""

    def __init__(self, clock: Clock | None = None) -> None:
        self._clock = clock or WallClock()
        self._name = self._figures = ""
        self._total: int | None = None
        self._done = 0
        self._began_s = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.finish()

    def stage(self, name: str, total: int | None = None) -> None:
        """End the last stage; begin another."""
        self.finish()
        self._name, self._total, self._done, self._figures = name, total, 0, ""
        self._began_s = self._clock.now_s()

    def expect(self, total: int) -> None:
        """Count the stage's steps up to another total."""
        self._total = total

    def step(self, done: int, **figures: float | int | str) -> None:
        """Remember the latest figures."""
        self._done = done
        self._figures = describe_figures(figures) or self._figures

    @abstractmethod
    def say(self, text: str) -> None:
        """Show the sentence."""

    def ask(self, request: str) -> None:
        """Show the request and wait for Enter."""
        self.say(f"{request}, then press Enter")
        _wait_for_enter(request)

    def finish(self) -> None:
        """End the running stage."""
        self._name = ""


class NotebookDisplay(_StageDisplay):
    """One line with a bar per stage below a notebook's cell, redrawn in place; it needs no widgets."""

    def __init__(self, clock: Clock | None = None) -> None:
        super().__init__(clock)
        self._lines: list[str] = []
        self._drawn_s = 0.0
        self._handle: Any = None

    def stage(self, name: str, total: int | None = None) -> None:
        """Close the last stage's line; begin another."""
        super().stage(name, total)
        self._draw()

    def step(self, done: int, **figures: float | int | str) -> None:
        """Move the bar and show the figures, as often as an eye follows."""
        super().step(done, **figures)
        if self._clock.now_s() - self._drawn_s >= 1 / REDRAWS_PER_SECOND:
            self._draw()

    def say(self, text: str) -> None:
        """Add the sentence above the running stage."""
        self._lines.append(f"<div>{html.escape(text)}</div>")
        self._draw()

    def finish(self) -> None:
        """Close the running stage's line."""
        if self._name:
            self._lines.append(self._line(ended=True))
            super().finish()
            self._draw()

    def _line(self, *, ended: bool = False) -> str:
        seconds = self._clock.now_s() - self._began_s
        most = self._total or 1
        # Without a total the bar shows that something goes on, and not how far.
        amount = f'value="{most}"' if ended else f'value="{min(self._done, most)}"' if self._total else ""
        told = "" if ended else html.escape(self._figures)
        return (
            f'<div style="display:flex;gap:1em;align-items:center;font-variant-numeric:tabular-nums">'
            f'<span style="min-width:7em">{html.escape(self._name)}</span>'
            f'<progress max="{most}" {amount}></progress><span>{seconds:.1f} s</span>'
            f'<span style="opacity:.7">{told}</span></div>'
        )

    def _draw(self) -> None:
        from IPython.display import HTML, display

        self._drawn_s = self._clock.now_s()
        running = [self._line()] if self._name else []
        drawn = HTML("".join([*self._lines, *running]))  # type: ignore[no-untyped-call]
        if self._handle is None:
            self._handle = display(drawn, display_id=True)  # type: ignore[no-untyped-call]
        else:
            self._handle.update(drawn)


class PlainDisplay(_StageDisplay):
    """One line at the end of each stage and one per sentence, without control characters."""

    def __init__(self, console: Console, clock: Clock | None = None) -> None:
        super().__init__(clock)
        self._console = console

    def say(self, text: str) -> None:
        """Write the sentence at once."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def finish(self) -> None:
        """Write the running stage's line."""
        if not self._name:
            return
        steps = f"{self._done} of {self._total}" if self._total and self._done != self._total else f"{self._done}"
        parts = [f"{self._clock.now_s() - self._began_s:.1f} s"]
        parts += [f"{steps} step{'' if steps == '1' else 's'}"] if self._done else []
        parts += [self._figures] if self._figures else []
        self.say(f"{self._name}: {', '.join(parts)}")
        super().finish()


class LiveDisplay:
    """A line with a bar per stage, the running stage's figures below, sentences above."""

    def __init__(self, console: Console) -> None:
        self._bars = _Bars(
            TextColumn(f"{{task.description:<{STAGE_WIDTH}}}", markup=False),
            BarColumn(bar_width=24, complete_style="cyan", finished_style="green", pulse_style="cyan"),
            _StepsColumn(),
            _TimeColumn(),
            console=console,
            refresh_per_second=REDRAWS_PER_SECOND,
        )
        self._task: TaskID | None = None

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._fill_bar()
        self._bars.stop()

    def stage(self, name: str, total: int | None = None) -> None:
        """Finish the last stage's bar; begin another."""
        self.finish()
        self._task = self._bars.add_task(name, total=total)

    def expect(self, total: int) -> None:
        """Draw the bar towards another total."""
        if self._task is not None:
            self._bars.update(self._task, total=total)

    def step(self, done: int, **figures: float | int | str) -> None:
        """Move the bar and show the figures."""
        if self._task is not None:
            self._bars.figures = describe_figures(figures) or self._bars.figures
            self._bars.update(self._task, completed=done)

    def say(self, text: str) -> None:
        """Print the sentence above the bars."""
        self._bars.console.print(text, markup=False, highlight=False)

    def ask(self, request: str) -> None:
        """Print the request where no bar is drawn over it, and wait for Enter."""
        self._bars.stop()
        for task in [task.id for task in self._bars.tasks if task.finished and task.id != self._task]:
            self._bars.remove_task(task)  # it stays as it was last drawn
        self._bars.console.print(f"{request}, then press Enter ", end="", markup=False, highlight=False, soft_wrap=True)
        _wait_for_enter(request)
        self._bars.start()

    def finish(self) -> None:
        """Fill the running stage's bar; its figures are no longer shown."""
        self._fill_bar()
        self._bars.figures = ""

    def _fill_bar(self) -> None:
        if self._task is None:
            return
        # A stage may end early, having converged: its bar is full all the same, at the steps it took.
        done = int(self._bars.done_of(self._task)) or 1
        self._bars.update(self._task, total=done, completed=done)
        self._task = None


def _wait_for_enter(request: str) -> None:
    try:
        input()
    except EOFError as error:
        raise InputError(f"{request}: nobody is there to press Enter", remedy="run it at a terminal") from error


class _Bars(Progress):
    """Rich's bars with one line of figures under the last."""

    figures = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        yield self.make_tasks_table(self.tasks)
        if self.figures:
            yield Padding(
                Text(self.figures, style="dim", no_wrap=True, overflow="ellipsis"), (0, 0, 0, STAGE_WIDTH + 1)
            )

    def done_of(self, task_id: TaskID) -> float:
        return next(task.completed for task in self.tasks if task.id == task_id)


class _StepsColumn(ProgressColumn):
    """Steps done, of how many where that is known."""

    def render(self, task: Task) -> Text:
        if task.finished or task.total is None:
            return Text(f"{task.completed:.0f}" if task.completed > 1 else "", justify="right")
        total = f"{task.total:.0f}"
        return Text(f"{task.completed:>{len(total)}.0f}/{total}", justify="right")


class _TimeColumn(ProgressColumn):
    """Time taken; of a running stage, time left as well."""

    def render(self, task: Task) -> Text:
        taken = f"{task.finished_time if task.finished and task.finished_time else task.elapsed or 0:.1f} s"
        if task.finished or task.time_remaining is None:
            return Text(taken, justify="right")
        return Text(f"{taken}, {spoken_duration(task.time_remaining)} left", style="cyan", justify="right")


def describe_figures(figures: dict[str, Any]) -> str:
    """Put figures in a row: `loss 0.0123 · held-out 0.0210 · 13 000 Gaussians`."""
    return " · ".join(_describe_figure(name, value) for name, value in figures.items())


def print_summary(folder: Path, console: Console | None = None) -> None:
    """Print the closing table of a run: how good, how long, where the pictures are.

    Args:
        folder: A run folder.
        console: Where to print; standard output if None.

    Raises:
        StorageError: The folder holds no readable report.
    """
    from gs2ci.evaluate.report import read_report

    report = read_report(folder)
    console = console or Console(highlight=False)
    table = Table(
        title=Text(f"{report.name}: {report.views} views from one exposure", style="bold"),
        title_justify="left",
        show_header=False,
        box=None,
        padding=(0, 3, 0, 0),
    )
    table.add_column(style="dim", no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(style="dim")
    for row in summary_rows(report):
        table.add_row(*(Text(cell) for cell in row))
    console.print()
    console.print(table)
    console.print()
    for found in (report.stopped, *report.notes):
        console.print(found.advice, markup=False, highlight=False)
    for name, what in (
        ("report.html", "look here first"),
        ("overview.png", "the same in one picture"),
        ("scene.ply", "for any 3DGS viewer"),
        ("report.json", ""),
    ):
        line = Text(f"{Path(folder) / name}")
        console.print(line.append(f"  {what}" if what else "", style="dim"), soft_wrap=True)


def summary_rows(report: "Report") -> list[tuple[str, str, str]]:
    """Collect name, value and remark of every figure that is known."""
    rows = []
    for own, decode, name, form, unit in (
        (report.psnr_db, report.decode.psnr_db, "PSNR", "{:.2f}", " dB"),
        (report.ssim, report.decode.ssim, "SSIM", "{:.4f}", ""),
    ):
        if own is not None and decode is not None:
            values = (min(own.per_view), own.mean, max(own.per_view), decode.mean)
            low, mean, high, of_decode = (form.format(value) for value in values)
            rows.append((name, mean + unit, f"decode {of_decode}; views {low} to {high}"))
    rows += _trajectory_rows(report.trajectory)
    if report.depth is not None:
        rows.append(("depth", *report.depth.errors().in_words()))
    residual = report.residual
    rows.append(("residual", f"{residual.rms:.4f} rms", f"{residual.mean_abs:.4f} mean absolute"))
    if report.heldout_rms is not None:
        others = [(name, rms) for name, rms in residual.heldout_rms if name != report.verdict]
        remark = ", ".join(f"{name} {rms:.4f}" for name, rms in others if rms is not None)
        rows.append(("held-out", f"{report.heldout_rms:.4f} rms", remark))
    seconds = report.seconds
    told = ("registration", "decode", "geometry", "fit")
    stages = ", ".join(f"{stage} {seconds[stage]:.1f} s" for stage in told if stage in seconds)
    rows.append(("time", spoken_duration(seconds["total"]), stages))
    rows.append(("Gaussians", f"{report.gaussians}", f"peak memory {report.peak_mib:.0f} MiB"))
    return rows


def _trajectory_rows(errors: "Trajectory | None") -> list[tuple[str, str, str]]:
    if errors is None:
        return []
    rows = []
    if errors.nate is not None:
        backwards = "; the path runs backwards: inside out" if errors.reversed else ""
        rows.append(("nATE", f"{errors.nate:.4f}", f"ATE {errors.ate:.4g}{backwards}"))
    remark = "" if errors.rpe_r_deg is None else f"RPE {errors.rpe_t:.4g}, {errors.rpe_r_deg:.3f}°"
    rows.append(("rotation", f"{errors.rotation_deg:.3f}°", remark))
    return rows


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

"""The display of a terminal."""

from types import TracebackType
from typing import Final, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.padding import Padding
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from gs2ci.api.display.stages import REDRAWS_PER_SECOND, RunningStage, StageDisplay, wait_for_enter
from gs2ci.core.clock import Clock
from gs2ci.core.durations import spoken_duration

NAME_WIDTH: Final = 12
BAR_WIDTH: Final = 24


class LiveDisplay(StageDisplay):
    """A line with a bar per stage, the running stage's figures below, sentences above."""

    def __init__(self, console: Console, clock: Clock | None = None) -> None:
        super().__init__(clock)
        self._over: list[RunningStage] = []
        self._live = Live(console=console, get_renderable=self._drawn, refresh_per_second=REDRAWS_PER_SECOND)

    def __enter__(self) -> Self:
        self._live.start(refresh=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:  # otherwise the bar stays unchanged
            self.finish()
        self._live.stop()

    def say(self, text: str) -> None:
        """Print the sentence above the bars."""
        self._live.console.print(text, markup=False, highlight=False)

    def ask(self, request: str) -> None:
        """Print the request with the bars stopped, and wait for Enter."""
        self._live.stop()
        self._over.clear()  # they stay as they were last drawn
        asked = f"{request}, then press Enter "
        self._live.console.print(asked, end="", markup=False, highlight=False, soft_wrap=True)
        wait_for_enter(request)
        self._live.start(refresh=True)

    def _ended(self, stage: RunningStage) -> None:
        stage.end(self._clock.now_s())
        self._over.append(stage)

    def _drawn(self) -> RenderableType:
        now_s, running = self._clock.now_s(), self._running
        lines = Table.grid(padding=(0, 1))
        lines.add_column(min_width=NAME_WIDTH, no_wrap=True)
        lines.add_column()
        lines.add_column(justify="right", no_wrap=True)
        lines.add_column(justify="right", no_wrap=True)
        for stage in [*self._over, running] if running else self._over:
            lines.add_row(Text(stage.name), _bar(stage), _steps(stage), _time(stage, now_s))
        if running is None or not running.figures:
            return lines
        figures = Text(running.figures, style="dim", no_wrap=True, overflow="ellipsis")
        return Group(lines, Padding(figures, (0, 0, 0, NAME_WIDTH + 1)))


def _bar(stage: RunningStage) -> ProgressBar:
    ended = stage.took_s is not None
    total = (stage.total or 1) if ended else stage.total
    return ProgressBar(
        None if total is None else float(total),
        float(total or 1) if ended else float(stage.done),
        BAR_WIDTH,
        complete_style="cyan",
        finished_style="green",
        pulse_style="cyan",
    )


def _steps(stage: RunningStage) -> Text:
    """Write the number of finished steps, and their total if it is known."""
    if stage.took_s is not None or stage.total is None:
        return Text(f"{stage.done}" if stage.done > 1 else "")
    return Text(f"{stage.done:>{len(str(stage.total))}}/{stage.total}")


def _time(stage: RunningStage, now_s: float) -> Text:
    """Write the time taken; of a running stage, the time left as well."""
    taken, left_s = f"{stage.seconds(now_s):.1f} s", stage.left_s(now_s)
    if left_s is None:
        return Text(taken)
    return Text(f"{taken}, {spoken_duration(left_s)} left", style="cyan")

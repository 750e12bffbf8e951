"""The display of a terminal, by rich."""

from collections.abc import Iterable
from typing import Final, Self

from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.table import Column
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
        self._bars = _Bars(
            TextColumn("{task.description}", markup=False, table_column=Column(min_width=NAME_WIDTH, no_wrap=True)),
            BarColumn(BAR_WIDTH),
            _Steps(),
            _Time(),
            console=console,
            refresh_per_second=REDRAWS_PER_SECOND,
            get_time=self._clock.now_s,
        )
        self._task = TaskID(0)

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, kind: object = None, *_: object) -> None:
        if kind is None:  # otherwise the bar stays unchanged
            self.finish()
        self._bars.stop()

    def say(self, text: str) -> None:
        """Print the sentence above the bars."""
        self._bars.console.print(text, markup=False, highlight=False)

    def ask(self, request: str) -> None:
        """Print the request with the bars stopped, and wait for Enter."""
        self._bars.stop()
        # Those that are over stay as they were last drawn.
        for task in self._bars.tasks:
            if self._running is None or task.id != self._task:
                self._bars.remove_task(task.id)
        asked = f"{request}, then press Enter "
        self._bars.console.print(asked, end="", markup=False, highlight=False, soft_wrap=True)
        wait_for_enter(request)
        self._bars.start()

    def stage(self, name: str, total: int | None = None) -> None:
        """End the last stage; begin another."""
        self.finish()
        self._task = self._bars.add_task(name, total=total)
        super().stage(name, total)

    def expect(self, total: int) -> None:
        """Change the stage's number of steps."""
        super().expect(total)
        self._changed()

    def _changed(self) -> None:
        if (stage := self._running) is not None:
            self._bars.figures = stage.figures
            self._bars.update(self._task, completed=stage.done, total=stage.total)

    def _ended(self, stage: RunningStage) -> None:
        planned = stage.total
        stage.end(self._clock.now_s())
        self._bars.figures = ""
        # Ended before its last step, its bar stays where it stood.
        total = planned if planned and stage.done else stage.done or 1
        self._bars.update(self._task, completed=stage.done or 1, total=total)
        self._bars.stop_task(self._task)


class _Bars(Progress):
    """The bars, and below them the figures of the running stage."""

    figures = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        """Yield both."""
        yield from super().get_renderables()
        if self.figures:
            figures = Text(self.figures, style="dim", no_wrap=True, overflow="ellipsis")
            yield Padding(figures, (0, 0, 0, NAME_WIDTH + 1))


class _Steps(MofNCompleteColumn):
    """The number of finished steps, and their total if it is known and not reached yet."""

    def render(self, task: Task) -> Text:
        """Write them."""
        if task.finished or task.total is None:
            return Text(f"{task.completed:.0f}" if task.completed > 1 else "")
        return super().render(task)


class _Time(ProgressColumn):
    """The time taken; of a running stage, the time left as well."""

    def render(self, task: Task) -> Text:
        """Write it."""
        taken, left_s = f"{task.finished_time or task.elapsed or 0.0:.1f} s", task.time_remaining
        if task.finished or task.stop_time is not None or left_s is None:
            return Text(taken)
        return Text(f"{taken}, {spoken_duration(left_s)} left", style="cyan")

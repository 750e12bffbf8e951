"""Displays without redrawing: plain lines for a file or a pipe, and silence."""

from typing import Final

from rich.console import Console

from gs2ci.api.display.stages import RunningStage, StageDisplay, wait_for_enter
from gs2ci.core.clock import Clock

# A file that is looked into now and then, or a connection that closes on silence, hears of a long stage so often.
BETWEEN_LINES_S: Final = 30.0


class PlainDisplay(StageDisplay):
    """One line at the end of each stage, now and then one within it, one per sentence, without control characters."""

    def __init__(self, console: Console, clock: Clock | None = None) -> None:
        super().__init__(clock)
        self._console = console
        self._said_s = 0.0

    def say(self, text: str) -> None:
        """Write the sentence at once."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def step(self, done: int, **figures: float | int | str) -> None:
        """Record the progress, and write it if nothing was written of this stage for long."""
        super().step(done, **figures)
        stage, now_s = self._running, self._clock.now_s()
        # The last step is about to be told by the stage's own line.
        if stage is not None and done != stage.total and now_s - max(self._said_s, stage.began_s) >= BETWEEN_LINES_S:
            self._said_s = now_s
            self._write(stage, "so far ")

    def __exit__(self, kind: object = None, *_: object) -> None:
        if kind is not None and self._running is not None:
            self._write(self._running, "broke off after ")
            self._running = None
        self.finish()

    def _ended(self, stage: RunningStage) -> None:
        self._write(stage)

    def _write(self, stage: RunningStage, so_far: str = "") -> None:
        steps = f"{stage.done} of {stage.total}" if stage.total and stage.done != stage.total else f"{stage.done}"
        # Many stages end as soon as nothing more is gained: what has so many steps left is not what still goes on.
        ended = "ended after " if stage.done and steps != f"{stage.done}" and not so_far else ""
        parts = [f"{stage.seconds(self._clock.now_s()):.1f} s"]
        parts += [f"{ended}{steps} step{'' if steps == '1' else 's'}"] if stage.done else []
        parts += [stage.figures] if stage.figures else []
        self.say(f"{stage.name}: {so_far}{', '.join(parts)}")


class QuietDisplay(StageDisplay):
    """Shows only what a person has to do."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console

    def say(self, text: str) -> None:
        """Ignore."""

    def ask(self, request: str) -> None:
        """Write the request and wait for Enter."""
        self._console.print(f"{request}, then press Enter", markup=False, highlight=False, soft_wrap=True)
        wait_for_enter(request)

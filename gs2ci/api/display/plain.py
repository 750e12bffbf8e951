"""Displays without redrawing: plain lines for a file or a pipe, and silence."""

from rich.console import Console

from gs2ci.api.display.stages import RunningStage, StageDisplay, wait_for_enter
from gs2ci.core.clock import Clock


class PlainDisplay(StageDisplay):
    """One line at the end of each stage and one per sentence, without control characters."""

    def __init__(self, console: Console, clock: Clock | None = None) -> None:
        super().__init__(clock)
        self._console = console

    def say(self, text: str) -> None:
        """Write the sentence at once."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def _ended(self, stage: RunningStage) -> None:
        steps = f"{stage.done} of {stage.total}" if stage.total and stage.done != stage.total else f"{stage.done}"
        parts = [f"{stage.seconds(self._clock.now_s()):.1f} s"]
        parts += [f"{steps} step{'' if steps == '1' else 's'}"] if stage.done else []
        parts += [stage.figures] if stage.figures else []
        self.say(f"{stage.name}: {', '.join(parts)}")


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

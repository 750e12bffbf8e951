"""The display below a notebook's cell."""

import html
from typing import Any

from gs2ci.api.display.stages import REDRAWS_PER_SECOND, RunningStage, StageDisplay
from gs2ci.core.clock import Clock


class NotebookDisplay(StageDisplay):
    """One line with a bar per stage below a notebook's cell, redrawn in place; it needs no widgets."""

    def __init__(self, clock: Clock | None = None) -> None:
        super().__init__(clock)
        self._lines: list[str] = []
        self._drawn_s = float("-inf")
        self._handle: Any = None

    def say(self, text: str) -> None:
        """Add the sentence above the running stage."""
        self._lines.append(f"<div>{html.escape(text)}</div>")
        self._draw()

    def _changed(self) -> None:
        if self._clock.now_s() - self._drawn_s >= 1 / REDRAWS_PER_SECOND:
            self._draw()

    def _ended(self, stage: RunningStage) -> None:
        stage.end(self._clock.now_s())
        self._lines.append(self._line(stage))
        self._draw()

    def _line(self, stage: RunningStage) -> str:
        ended, most = stage.took_s is not None, stage.total or 1
        # Without a total the bar shows activity, not progress.
        amount = f'value="{most}"' if ended else f'value="{min(stage.done, most)}"' if stage.total else ""
        told = "" if ended else html.escape(stage.figures)
        return (
            f'<div style="display:flex;gap:1em;align-items:center;font-variant-numeric:tabular-nums">'
            f'<span style="min-width:7em">{html.escape(stage.name)}</span>'
            f'<progress max="{most}" {amount}></progress><span>{stage.seconds(self._clock.now_s()):.1f} s</span>'
            f'<span style="opacity:.7">{told}</span></div>'
        )

    def _draw(self) -> None:
        from IPython.display import HTML, display

        self._drawn_s = self._clock.now_s()
        running = [self._line(self._running)] if self._running else []
        drawn = HTML("".join([*self._lines, *running]))  # type: ignore[no-untyped-call]
        if self._handle is None:
            self._handle = display(drawn, display_id=True)  # type: ignore[no-untyped-call]
        else:
            self._handle.update(drawn)

"""The interface by which a long computation reports its progress.

Here: the interface through which stages report, and the listener that says nothing. Not here: drawing (the live display
is `gs2ci.api.display`).
"""

from typing import Protocol


class Progress(Protocol):
    """A listener for stages and steps."""

    def stage(self, name: str, total: int | None = None) -> None:
        """Begin a stage of `total` steps (None: not known beforehand)."""

    def expect(self, total: int) -> None:
        """Say that the running stage will have `total` steps after all."""

    def step(self, done: int, **figures: float | int | str) -> None:
        """Report that `done` steps of the stage are finished, with any figures worth showing."""

    def say(self, text: str) -> None:
        """Pass on one sentence that the user should read: a guess made, a fallback taken."""


class Silent:
    """A listener that shows nothing and keeps the sentences, for tests and library use."""

    def __init__(self) -> None:
        self.sentences: list[str] = []

    def stage(self, name: str, total: int | None = None) -> None:
        """Ignore."""

    def expect(self, total: int) -> None:
        """Ignore."""

    def step(self, done: int, **figures: float | int | str) -> None:
        """Ignore."""

    def say(self, text: str) -> None:
        """Keep the sentence."""
        self.sentences.append(text)

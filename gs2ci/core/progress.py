"""The interface by which a long computation reports its progress.

Here: the interface through which stages report, and the silent listener. Not here: drawing (`gs2ci.api.display`).
"""

from collections.abc import Iterable
from typing import Protocol

from gs2ci.core.findings import Finding


class Progress(Protocol):
    """A listener for stages and steps.

    Example:
        >>> class Stages(gs2ci.Silent):
        ...     def stage(self, name, total=None):
        ...         print(name)
        >>> decoded = gs2ci.decode("shot.h5", iterations=5, coupling=0.0, registration="off", progress=Stages())
        decode
    """

    def stage(self, name: str, total: int | None = None) -> None:
        """Begin a stage of `total` steps (None if not known in advance)."""

    def expect(self, total: int) -> None:
        """Change the number of steps of the running stage to `total`."""

    def step(self, done: int, **figures: float | int | str) -> None:
        """Report that `done` steps of the stage are finished, with figures to show."""

    def say(self, text: str) -> None:
        """Pass on one sentence that the user should read: a guess made, a fallback taken."""


class Silent:
    """A listener that shows nothing and keeps the sentences, for tests and library use.

    Example:
        >>> heard = gs2ci.Silent()
        >>> decoded = gs2ci.decode("shot.h5", iterations=5, progress=heard)
        >>> heard.sentences
        []
    """

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


def said(notes: Iterable[Finding], progress: Progress) -> tuple[Finding, ...]:
    """Pass on the sentence of each finding, and return the findings."""
    kept = tuple(notes)
    for note in kept:
        progress.say(note.sentence)
    return kept

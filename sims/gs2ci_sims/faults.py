"""Faults that can be injected into twins by name, and the record of those that occurred.

`faults.toml` says what each of them does; a test or a rig file injects them by name into the twin's `FaultSet`; the
twin calls `take` at every place where the fault could occur.

Here: names, counting, the record. Not here: what a fault does (each twin in `gs2ci_sims.wires`).
"""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Final

from gs2ci.core.errors import InputError

_FAMILIES: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
KNOWN: Final = {f"{family}.{name}": text for family, names in _FAMILIES.items() for name, text in names.items()}
"""What each fault does, by its name "<family>.<what>" ("serial.reply_lost"); a twin elsewhere adds its own."""


@dataclass
class Injected:
    """A fault that is injected and has not occurred yet.

    Args:
        name: Its name.
        skip: Number of opportunities to skip first.
        times: How often it occurs.
        value: A number that the fault needs (seconds late, position of a stall, ...).
        about: It occurs only if this text is part of the twin's description of the opportunity.
    """

    name: str
    skip: int = 0
    times: int = 1
    value: float = 0.0
    about: str = ""


class FaultSet:
    """The faults that one twin will have."""

    def __init__(self) -> None:
        self.waiting: list[Injected] = []
        self.struck: list[tuple[str, str]] = []

    def inject(self, name: str, *, skip: int = 0, times: int = 1, value: float = 0.0, about: str = "") -> Injected:
        """Let a fault occur at its next opportunity, or later; see `Injected` for the arguments.

        Raises:
            InputError: No such fault; the message gives the most similar name.
        """
        if name not in KNOWN:
            near = get_close_matches(name, KNOWN, n=1)
            raise InputError(
                f"no fault is called {name!r}",
                allowed=", ".join(sorted(KNOWN)),
                remedy=f"did you mean {near[0]!r}?" if near else "",
            )
        injected = Injected(name, skip, times, value, about)
        self.waiting.append(injected)
        return injected

    def take(self, name: str, about: str = "") -> Injected | None:
        """Return the fault if it occurs at this opportunity, otherwise None.

        Args:
            name: The fault that could occur here, one of `KNOWN`.
            about: Description of the opportunity: a command's text, a message's name.
        """
        assert name in KNOWN, name
        for injected in self._matching(name, about):
            if injected.skip > 0:
                injected.skip -= 1
                continue
            injected.times -= 1
            self.struck.append((name, about))
            return injected
        return None

    def clear(self) -> None:
        """Delete all faults that have not occurred yet."""
        self.waiting.clear()

    def _matching(self, name: str, about: str) -> Iterator[Injected]:
        for injected in self.waiting:
            if injected.name == name and injected.times > 0 and injected.about in about:
                yield injected

"""Named faults that twins can be told to have, and the record of those that struck.

A twin's module declares the faults it knows with `declare`; a test or a rig file injects them by name into the
`FaultSet` that the twin was given; the twin calls `take` wherever the fault could strike.

Here: names, counting, the record. Not here: what a fault does (each twin in `gs2ci_sims.wires`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches

from gs2ci.core.errors import InputError


@dataclass(frozen=True)
class FaultKind:
    """A fault that some twin knows.

    Args:
        name: Its name, "<family>.<what>" ("serial.reply_lost").
        summary: What happens on the wire or in the device, for the table of faults.
    """

    name: str
    summary: str


_KINDS: dict[str, FaultKind] = {}


def declare(name: str, summary: str) -> FaultKind:
    """Make a fault known; for use at the top level of a twin's module.

    Raises:
        InputError: Another summary is declared under this name already.
    """
    kind = FaultKind(name, summary)
    if _KINDS.setdefault(name, kind) != kind:
        raise InputError(f"fault {name!r} is declared twice", allowed="one summary per name")
    return kind


def known() -> tuple[FaultKind, ...]:
    """Return the faults of all twins that are imported, by name."""
    return tuple(_KINDS[name] for name in sorted(_KINDS))


def find(name: str) -> FaultKind:
    """Return the fault of this name.

    Raises:
        InputError: No such fault; names the nearest.
    """
    if name not in _KINDS:
        near = get_close_matches(name, _KINDS, n=1)
        raise InputError(
            f"no fault is called {name!r}",
            allowed=", ".join(sorted(_KINDS)),
            remedy=f"did you mean {near[0]!r}?" if near else "",
        )
    return _KINDS[name]


@dataclass
class Injected:
    """A fault waiting for its moment.

    Args:
        kind: Which.
        skip: Opportunities to let pass first.
        times: How often it strikes, then never again.
        value: A number that the fault needs (seconds late, position of a stall, ...).
        about: It strikes only where this text is part of what the twin says of the opportunity.
    """

    kind: FaultKind
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
        """Let a fault strike at its next opportunity, or later; see `Injected` for the arguments.

        Raises:
            InputError: No such fault.
        """
        injected = Injected(find(name), skip, times, value, about)
        self.waiting.append(injected)
        return injected

    def take(self, kind: FaultKind, about: str = "") -> Injected | None:
        """Return the fault if it strikes at this opportunity, else None.

        Args:
            kind: The fault that could strike here.
            about: What is going on: a command's text, a message's name.
        """
        for injected in self._matching(kind, about):
            if injected.skip > 0:
                injected.skip -= 1
                continue
            injected.times -= 1
            self.struck.append((kind.name, about))
            return injected
        return None

    def clear(self) -> None:
        """Forget all that still waits."""
        self.waiting.clear()

    def _matching(self, kind: FaultKind, about: str) -> Iterator[Injected]:
        for injected in self.waiting:
            if injected.kind is kind and injected.times > 0 and injected.about in about:
                yield injected

"""Named faults that can be injected into twins, and the record of those that occurred.

A twin's module declares the faults that it supports with `declare`; a test or a rig file injects them by name into the
twin's `FaultSet`; the twin calls `take` at every place where the fault could occur.

Here: names, counting, the record. Not here: what a fault does (each twin in `gs2ci_sims.wires`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path

from gs2ci.core.errors import InputError


@dataclass(frozen=True)
class FaultKind:
    """A fault that some twin supports.

    Args:
        name: Its name, "<family>.<what>" ("serial.reply_lost").
        summary: What happens on the wire or in the device, for the table of faults.
    """

    name: str
    summary: str


_KINDS: dict[str, FaultKind] = {}


def declare(name: str, summary: str) -> FaultKind:
    """Register a fault; for use at the top level of a twin's module.

    Raises:
        InputError: Another summary is declared under this name already.
    """
    kind = FaultKind(name, summary)
    if _KINDS.setdefault(name, kind) != kind:
        raise InputError(f"fault {name!r} is declared twice", allowed="one summary per name")
    return kind


def known() -> tuple[FaultKind, ...]:
    """Return the faults of all twins of this package, and of others that are imported, by name."""
    _import_twins()
    return tuple(_KINDS[name] for name in sorted(_KINDS))


def find(name: str) -> FaultKind:
    """Return the fault of this name.

    Raises:
        InputError: No such fault; the message gives the most similar name.
    """
    if name not in _KINDS:
        _import_twins()
    if name not in _KINDS:
        near = get_close_matches(name, _KINDS, n=1)
        raise InputError(
            f"no fault is called {name!r}",
            allowed=", ".join(sorted(_KINDS)),
            remedy=f"did you mean {near[0]!r}?" if near else "",
        )
    return _KINDS[name]


def _import_twins() -> None:
    """Import every twin's module, which declares its faults: a bench imports those of its own devices alone."""
    folder = Path(__file__).parent / "wires"
    for path in sorted(folder.glob("*.py")):
        import_module(f"gs2ci_sims.wires.{path.stem}")


@dataclass
class Injected:
    """A fault that is injected and has not occurred yet.

    Args:
        kind: The fault.
        skip: Number of opportunities to skip first.
        times: How often it occurs.
        value: A number that the fault needs (seconds late, position of a stall, ...).
        about: It occurs only if this text is part of the twin's description of the opportunity.
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
        """Let a fault occur at its next opportunity, or later; see `Injected` for the arguments.

        Raises:
            InputError: No such fault.
        """
        injected = Injected(find(name), skip, times, value, about)
        self.waiting.append(injected)
        return injected

    def take(self, kind: FaultKind, about: str = "") -> Injected | None:
        """Return the fault if it occurs at this opportunity, otherwise None.

        Args:
            kind: The fault that could occur here.
            about: Description of the opportunity: a command's text, a message's name.
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
        """Delete all faults that have not occurred yet."""
        self.waiting.clear()

    def _matching(self, kind: FaultKind, about: str) -> Iterator[Injected]:
        for injected in self.waiting:
            if injected.kind is kind and injected.times > 0 and injected.about in about:
                yield injected

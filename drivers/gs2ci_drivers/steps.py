"""Steps with their inverses: the steps that were done are undone in reverse order.

Here: doing steps in order, and undoing them in reverse even if an undo raises an error. Not here: what the steps of
a capture are (`gs2ci_drivers.acquisition`).
"""

from collections.abc import Callable
from typing import Self, TypeVar

T = TypeVar("T")


class Steps:
    """A context in which every step done is undone at the end, in reverse order, whatever happened.

    An undo that fails, or is interrupted, is noted on the error being raised (or raised itself, if there is none), and
    the other undos still run: a second Ctrl-C must not leave a stage moving.
    """

    def __init__(self) -> None:
        self.log: list[str] = []
        """What was done and undone, in order."""
        self._undo: list[tuple[str, Callable[[], object]]] = []

    def do(self, name: str, action: Callable[[], T], undo: Callable[[], object] | None = None) -> T:
        """Do a step; its undo is registered before it begins, because half a step may need undoing too."""
        self.log.append(name)
        if undo is not None:
            self._undo.append((name, undo))
        return action()

    def unwind(self, under_way: BaseException | None = None) -> list[BaseException]:
        """Run all registered undos, newest first; return the errors that they raised."""
        met: list[BaseException] = []
        while self._undo:
            name, undo = self._undo.pop()
            self.log.append(f"undo {name}")
            try:
                undo()
            except BaseException as error:
                met.append(error)
                if under_way is not None:
                    under_way.add_note(f"undoing «{name}» failed too: {str(error) or type(error).__name__}")
        return met

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        met = self.unwind(error)
        if error is None and met:
            raise met[0]

"""Observations of exposures that an unfinished run keeps.

Here: what of them is kept, and how they are made of it again. Not here: the files (`unfinished`), observing
(`observing`).
"""

from collections.abc import Callable

from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.reconstruct.exposures.observing import Keeping
from gs2ci.reconstruct.exposures.unfinished import Unfinished, arrays_of
from gs2ci.reconstruct.fit.coarse.looks import Score
from gs2ci.reconstruct.observe import KeptObservation, Observed, Tools, observe
from gs2ci.reconstruct.settings import Settings


def observations(unfinished: Unfinished, tools: Tools, progress: Progress) -> Keeping:
    """Return what observes exposures that are not observed yet, and keeps what they show on the disk."""

    def kept(number: int, shot: Shot, settings: Settings, score: Score | None) -> Callable[[], Observed]:
        def see() -> KeptObservation:
            return KeptObservation.of(observe(shot, settings, tools, progress, score, Halt(), None))

        read = unfinished.done(f"exposure-{number:03}", see, arrays_of(shot))
        return lambda: read().observed(shot, settings, progress, score)

    return kept

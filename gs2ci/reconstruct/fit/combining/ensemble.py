"""Several fits to one measurement, side by side, and the mean of their views.

One coded measurement does not determine N views: a fit fills in what no mask let through, and fits with slightly
different starts fill it in differently. Where fits agree, the measurement determines them; where they differ, their
mean is nearer the truth than any of them (the mean of posterior samples has the least expected squared error).

Here: how fits are made to differ, how they run at the same time, and how their views are combined. Not here: a fit
(`coarse/stage.py`).
"""

import math
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass
from typing import Final

import numba
import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from gs2ci.core.arrays import F32
from gs2ci.core.errors import NumericsError
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.run_figures import EnsembleSection
from gs2ci.reconstruct.fit.coarse.stage import CoarseFit, CoarseRun
from gs2ci.reconstruct.fit.density.base import DensityRule
from gs2ci.reconstruct.measurement.holdout import Holdout, surely_larger
from gs2ci.render.gaussians import Gaussians

_STREAM: Final = 0x3A7E  # makes these random draws independent of all others of the same seed
_SCATTER: Final = 0.5
"""How far the first Gaussians of a companion are displaced from the leader's, in their own standard deviations: enough
to make fits differ from the first iteration on, too little to spoil the geometry's estimate."""


Refine = Callable[[F32], F32]
"""Adds the decoded residual to views, [N, H, W, C]."""

_NEIGHBOURHOOD_PX: Final = 1.0
"""A few fits often agree in one pixel by chance; their disagreement over a few pixels predicts the error better."""


@dataclass(frozen=True)
class Member:
    """One fit of an ensemble: the inputs in which it differs from the others.

    Args:
        start: First Gaussians.
        density: Its density rule.
        seed: Of its random draws.
        outside: Which first Gaussians lie beyond the borders of all views, if another fit left them, [G] bool.
    """

    start: Gaussians
    density: DensityRule
    seed: int
    outside: torch.Tensor | None = None


def member_seed(seed: int, number: int, stream: int = _STREAM) -> int:
    """Return the seed of one of several of a kind, a stream, that are given this seed: the first has it itself."""
    if number == 0:
        return seed
    return int(np.random.SeedSequence([seed, stream, number]).generate_state(1, np.uint64)[0] >> 1)


def members(start: Gaussians, rules: Sequence[DensityRule], count: int, seed: int) -> tuple[Member, ...]:
    """Return the members of an ensemble: the first with the given start, the others scattered about it.

    Args:
        start: First Gaussians.
        rules: Density rules, used in turn: fits whose errors differ average better.
        count: How many.
        seed: Of every draw.
    """
    found = [Member(start, rules[0], member_seed(seed, 0))]
    for number in range(1, count):
        own = member_seed(seed, number)
        draw = torch.Generator().manual_seed(own)
        scattered = start.map(lambda tensor: tensor.clone())
        # First Gaussians are spheres, so that their orientation does not matter.
        scattered.means = start.means + _SCATTER * start.log_scales.exp() * torch.randn(
            start.means.shape, generator=draw
        )
        found.append(Member(scattered, rules[number % len(rules)], own))
    return tuple(found)


def advance_together(
    runs: Sequence[CoarseRun],
    share: float,
    progress: Progress,
) -> tuple[CoarseRun, ...]:
    """Continue fits at the same time, each on its share of the threads, until a share of their schedules is done.

    Several fits use the processors better than one fit on all threads, and no fit depends on another.

    Args:
        runs: At least one; the first one is the leader.
        share: Of each one's schedule.
        progress: Receives the leader's steps.

    Returns:
        The leader, then the others in their order, without any whose numbers were not finite.

    Raises:
        NumericsError: The leader is not finite from its first iteration on.
        Gs2ciError: Whatever else a fit raises.
    """
    leader, *others = runs
    if not others:
        leader.advance(share, progress)
        return (leader,)
    threads = numba.get_num_threads()
    each = max(1, threads // len(runs))
    stop = threading.Event()

    def accompany(run: CoarseRun) -> None:
        torch.set_num_threads(1)
        numba.set_num_threads(each)
        run.advance(share, _Until(stop))

    with ThreadPoolExecutor(len(others), "companion fit") as pool:
        running = [pool.submit(copy_context().run, accompany, run) for run in others]
        try:
            numba.set_num_threads(max(1, threads - each * len(others)))
            leader.advance(share, progress)
            progress.stage("other fits")
            return (leader, *(run for run, ends in zip(others, running, strict=True) if _is_sound(ends, progress)))
        finally:
            stop.set()
            numba.set_num_threads(threads)


def _is_sound(companion: Future[None], progress: Progress) -> bool:
    """Wait for a companion; return False, and say so, if its numbers were not finite."""
    try:
        companion.result()
    except NumericsError as error:
        progress.say(f"One of the further fits failed and is left out: {error.problem}.")
        return False
    return True


class _Stopped(Exception):  # noqa: N818 - ends a thread whose result is no longer wanted; not an error
    """The leader failed, or the user interrupted the run."""


class _Until(Silent):
    """A progress listener that ends its fit when an event is set."""

    def __init__(self, stop: threading.Event) -> None:
        super().__init__()
        self._stop = stop

    def step(self, done: int, **figures: float | int | str) -> None:
        """Do nothing, or end the fit.

        Raises:
            _Stopped: The event is set.
        """
        if self._stop.is_set():
            raise _Stopped


@dataclass(frozen=True)
class Ensemble:
    """Fits to one measurement.

    Args:
        best: The one whose refined views explain the held-out pixels best; its scene and cameras are the result.
        views: The mean of all fits' views, [N, H, W, C]; those of the best alone if they surely explain the held-out
            pixels better.
        averaged: How many fits the views are the mean of.
        disagreement: How far the fits' views are from their mean, root-mean-square over fits and colours and a few
            neighbouring pixels, [N, H, W] float32 in full scales; None with one fit.
        others: The fits beside the best.
    """

    best: CoarseFit
    views: F32
    averaged: int = 1
    disagreement: F32 | None = None
    others: tuple[CoarseFit, ...] = ()

    @property
    def notes(self) -> Findings:
        """Get the findings of each fit, and whether their mean was rejected."""
        beside = (
            finding(Code.OF_ANOTHER_FIT, sentence=note.sentence, code=note.code)
            for fit in self.others
            for note in fit.notes
        )
        refused = bool(self.others) and self.averaged == 1
        doubt = (finding(Code.MEAN_REFUSED),) if refused else ()
        return (*self.best.notes, *beside, *doubt)

    def summary(self) -> EnsembleSection:
        """Return the figures for the report."""
        spread = None if self.disagreement is None else float(np.sqrt(np.mean(self.disagreement**2, dtype=np.float64)))
        return EnsembleSection(1 + len(self.others), self.averaged, spread)


def combined(fits: tuple[CoarseFit, ...], holdout: Holdout, refine: Refine) -> Ensemble:
    """Take the mean of the fits' views, unless the best of them alone is surely better.

    Args:
        fits: At least one; one at least may lead (`CoarseFit.beside`).
        holdout: The measurement and its held-out pixels; without any, the first fit leads and the mean is taken.
        refine: Adds the decoded residual to views, as before delivery.
    """
    if len(fits) == 1:
        return Ensemble(fits[0], fits[0].views)
    together, disagreement = _mean(fits)
    if not holdout.pixels.any():
        return Ensemble(fits[0], together, len(fits), disagreement, fits[1:])
    alone = [holdout.squared_residuals(refine(fit.views)) for fit in fits]
    means = [math.inf if fit.beside else squared.mean() for fit, squared in zip(fits, alone, strict=True)]
    first = int(np.argmin(means))
    best, others = fits[first], (*fits[:first], *fits[first + 1 :])
    if surely_larger(holdout.squared_residuals(refine(together)), alone[first]):
        return Ensemble(best, best.views, 1, disagreement, others)
    return Ensemble(best, together, len(fits), disagreement, others)


def _mean(fits: tuple[CoarseFit, ...]) -> tuple[F32, F32]:
    """Return the mean of the fits' views, [N, H, W, C], and how far they are from it, [N, H, W].

    View by view, since the float64 views of all fits to a large shot might not fit into memory at once.
    """
    together = np.empty(fits[0].views.shape, np.float32)
    disagreement = np.empty(together.shape[:3], np.float32)
    for number in range(len(together)):
        own = np.stack([fit.views[number] for fit in fits]).astype(np.float64)
        mean = own.mean(axis=0)
        squares = np.mean((own - mean) ** 2, axis=(0, 3))
        together[number] = mean
        disagreement[number] = np.sqrt(gaussian_filter(squares, _NEIGHBOURHOOD_PX))
    return together, disagreement

"""Faults injected into the optimiser of a running reconstruction: what must be caught, rolled back and reported.

Each is a context manager in which a reconstruction fails at a given iteration. Not here: the expected outcome
(`cases`).
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from itertools import count
from typing import Any
from unittest.mock import patch
from weakref import WeakKeyDictionary

import numpy as np
import torch

from gs2ci.reconstruct.fit.losses.objective import DataTerm
from gs2ci.reconstruct.fit.optimiser.gaussians import GaussianOptimiser
from gs2ci.reconstruct.fit.optimiser.poses import PoseCorrections

Fault = Callable[[], AbstractContextManager[Any]]
Strikes = Callable[[int], bool]


def none() -> AbstractContextManager[Any]:
    """Let nothing go wrong."""
    return nullcontext()


def once(call: int) -> Strikes:
    """Strike at one call, counted from 0."""
    return lambda number: number == call


def ever_since(call: int) -> Strikes:
    """Strike at a call and at all later ones."""
    return lambda number: number >= call


def gradient(value: float, strikes: Strikes) -> Fault:
    """Put a number into the gradient of the loss by one row of pixels (over a single one, all masks may be closed)."""
    return lambda: _after(DataTerm, "value_and_gradient", strikes, lambda _, result: _spoil(result, value))


def loss(value: float, strikes: Strikes) -> Fault:
    """Report a number as the loss."""
    return lambda: _after(DataTerm, "value_and_gradient", strikes, lambda _, result: (value, result[1]))


def parameter(name: str, factor: float, strikes: Strikes) -> Fault:
    """Let a step of the Gaussians explode: multiply all values of one parameter after it."""

    def explode(optimiser: GaussianOptimiser, _: object) -> None:
        with torch.no_grad():
            optimiser.scene.parameters()[name].mul_(factor)

    return lambda: _after(GaussianOptimiser, "step", strikes, explode)


def poses(by: float, strikes: Strikes) -> Fault:
    """Let a step of the poses explode: add a number to all twists after it."""

    def explode(corrections: PoseCorrections, _: object) -> None:
        corrections.restore(corrections.snapshot() + by)

    return lambda: _after(PoseCorrections, "step", strikes, explode)


def _spoil(result: tuple[float, np.ndarray], value: float) -> tuple[float, np.ndarray]:
    spoilt = result[1].copy()
    spoilt[len(spoilt) // 2] = value
    return result[0], spoilt


@contextmanager
def _after(owner: type, method: str, strikes: Strikes, then: Callable[[Any, Any], Any]) -> Iterator[None]:
    """Let `then` change object and result of a method's calls that are struck.

    Calls are counted for each object: fits run side by side, and each is struck at its own.
    """
    whole = getattr(owner, method)
    calls: WeakKeyDictionary[Any, Iterator[int]] = WeakKeyDictionary()

    def faulty(self: Any, *args: Any, **keywords: Any) -> Any:
        result = whole(self, *args, **keywords)
        return then(self, result) if strikes(next(calls.setdefault(self, count()))) else result

    with patch.object(owner, method, faulty):
        yield

"""How many iterations a fit has: a given number, or as many as end before a deadline.

Here: the two paces, and one that times a few iterations. Not here: the loop that follows them (`stage.py`), the choice
of a deadline (`gs2ci.reconstruct.presets.budget`).
"""

import time
from collections.abc import Callable
from typing import Final

import numpy as np

# Seconds of an iteration, by the share of the schedule that is done.
Costs = Callable[[float], float]

# Everything after the last look takes about as long as this many looks: the views of two fits and of their mean are
# refined without the held-out pixels, then with all pixels, and the scene is rendered for views and for depth.
LOOKS_AFTERWARDS: Final = 4
_REVIEW_EVERY: Final = 10
# The share of an iteration that further threads do not speed up: two threads take 0.65 of the time of one.
_ON_ONE_THREAD: Final = 0.3
# The latest iterations show the machine's present load; the mean of all earlier ones is less noisy.
_TRUST_IN_THE_LATEST: Final = 0.5
# Shares of a schedule at which its iterations are looked at.
SAMPLES: Final = (np.arange(16) + 0.5) / 16


class Pace:
    """Tells the fit how long its schedule is: a number of iterations, whatever time they take.

    The same seed gives the same result then.

    Args:
        iterations: How many.
    """

    def __init__(self, iterations: int) -> None:
        self._iterations = iterations

    def total(self, done: int) -> int:
        """Return the length of the schedule after `done` iterations; the fit ends if this is not above `done`."""
        return self._iterations

    def looked(self, seconds: float) -> None:
        """Record how long a look at the held-out pixels took."""

    def is_late(self, done: int) -> bool:
        """Tell whether the deadline, and not the number of iterations, ended the schedule."""
        return False

    def beside(self) -> "Pace":
        """Return a pace for another fit that runs at the same time."""
        return self


class Timed(Pace):
    """A few iterations, to time them.

    Args:
        iterations: How many.
        moments_per_mask: How many moments a mask has in them on average.

    Attributes:
        look_s: Seconds of the latest look.
    """

    def __init__(self, iterations: int, moments_per_mask: float = 1.0) -> None:
        super().__init__(iterations)
        self.moments_per_mask = moments_per_mask
        self._moments_s: list[float] = []
        self._processor_s: list[float] = []
        self.look_s = 0.0

    @property
    def waiting(self) -> float:
        """Get wall-clock seconds per processor second: 1 unless other programs used the processors too."""
        return max(1.0, float(np.ptp(self._moments_s) / max(np.ptp(self._processor_s), 1e-3)))

    @property
    def iteration_s(self) -> float:
        """Get the seconds of an iteration: the median of all but the first, which also allocates memory."""
        return float(np.median(np.diff(self._moments_s)[1:]))

    def total(self, done: int) -> int:
        """Note the time; return the number given."""
        self._moments_s.append(time.monotonic())
        self._processor_s.append(time.process_time())
        return self._iterations

    def looked(self, seconds: float) -> None:
        """Record how long a look took."""
        self.look_s = seconds

    def costs(self, slower: float, mask_moments_from: float) -> Costs:
        """Return what iterations cost that are so many times slower, masks in several moments from a share on."""

        def seconds(share: float) -> float:
            moments = 1.0 if share < mask_moments_from else self.moments_per_mask
            # The number of Gaussians grows during a fit, whose last iterations cost twice as much as the first.
            return self.iteration_s * slower * (1 + share) * moments / self.moments_per_mask

        return seconds

    def beside(self) -> "Timed":
        """Return another one."""
        return Timed(self._iterations, self.moments_per_mask)


def slower_beside(fits: int, threads: int) -> float:
    """Return how much longer an iteration takes with so many fits side by side than alone (Amdahl's law)."""
    own = threads / fits
    return (_ON_ONE_THREAD + (1 - _ON_ONE_THREAD) / own if own >= 1 else 1 / own) / (
        _ON_ONE_THREAD + (1 - _ON_ONE_THREAD) / threads
    )


class Deadline(Pace):
    """As many iterations as end before a deadline; their number follows the measured speed of the fit.

    The schedule is stretched or shortened as a whole: step sizes and densification follow the share of it that is
    done, so that a fit that ends by the clock has been through all of it. The result then depends on the machine.

    Args:
        most: Largest number of iterations.
        until_s: When the views must have been delivered, on `clock`.
        costs: Expected seconds of an iteration without looks; only the shape counts once the fit runs.
        look_s: Expected seconds of a look.
        look_every: Iterations between looks.
        clock: The time in seconds; never decreases.
    """

    def __init__(
        self,
        most: int,
        until_s: float,
        costs: Costs,
        look_s: float,
        look_every: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(most)
        self._until_s = until_s
        self._costs = costs
        self._look_s = look_s
        self._look_every = look_every
        self._clock = clock
        self._looks = 0
        self._slowness = 1.0
        self._reviewed = 0
        self._reviewed_s = 0.0
        self._looking_s = 0.0
        self._total = most

    def total(self, done: int) -> int:
        """Return the present estimate of the schedule's length; `done` if another iteration would be too late."""
        now_s = self._clock()
        if done == 0:
            self._reviewed_s = now_s
            self._total = max(1, self._affordable(0, now_s))
        elif done - self._reviewed >= _REVIEW_EVERY or done >= self._total:
            self._learn(done, now_s)
            self._total = self._affordable(done, now_s)
        return self._total

    def looked(self, seconds: float) -> None:
        """Record how long a look took: the mean of the latest three replaces the first expectation."""
        self._looks += 1
        self._looking_s += seconds
        self._look_s += (seconds - self._look_s) / min(self._looks, 3)

    def is_late(self, done: int) -> bool:
        """Tell whether the deadline came before all iterations were done."""
        return done < self._iterations

    def beside(self) -> "Deadline":
        """Return a pace with the same deadline that learns its own speed."""
        return Deadline(self._iterations, self._until_s, self._costs, self._look_s, self._look_every, self._clock)

    def _learn(self, done: int, now_s: float) -> None:
        took_s = max(0.0, now_s - self._reviewed_s - self._looking_s)
        expected_s = self._expected_s(self._reviewed, done, max(done, self._total))
        if expected_s > 0:
            trust = 1.0 if self._reviewed == 0 else _TRUST_IN_THE_LATEST
            self._slowness += trust * (took_s / expected_s - self._slowness)
        self._reviewed, self._reviewed_s, self._looking_s = done, now_s, 0.0

    def _affordable(self, done: int, now_s: float) -> int:
        """Return the longest schedule, `done` at least, that ends in time."""
        left_s = self._until_s - now_s - (LOOKS_AFTERWARDS + 1) * self._look_s
        low, high = done, max(done, self._iterations)
        while low < high:
            total = (low + high + 1) // 2
            looks = (total - done) // self._look_every
            if self._slowness * self._expected_s(done, total, total) + looks * self._look_s <= left_s:
                low = total
            else:
                high = total - 1
        return low

    def _expected_s(self, begin: int, end: int, total: int) -> float:
        """Return the expected seconds of the iterations from `begin` to `end` of a schedule of `total`."""
        shares = (begin + (end - begin) * SAMPLES) / max(total, 1)
        return (end - begin) * float(np.mean([self._costs(float(share)) for share in shares]))

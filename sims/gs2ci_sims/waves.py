"""What each mask's light collects of the moving image's cosines, exactly and as sampled at a few moments.

A cosine that runs across the image turns in phase as a point of the image moves. When each mask's light is collected is
known (`signals.Slices`), and so is how views stand for it (`moments.Moments`); the difference of the two integrals is
what sampling gets wrong of that cosine behind that mask. Here: these differences, for points at the ends of the scene's
depth. Not here: how strong which cosines are (`preview`), who chooses the moments (`sampling`).
"""

from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci_sims.moments import Moments, gauss_nodes, gauss_weights
from gs2ci_sims.motion import image_travel_px, tracks_px
from gs2ci_sims.path import CameraPath, highest_hz
from gs2ci_sims.scene import Scene
from gs2ci_sims.signals import Slices

# Frequencies of the image, cycles per pixel, up to twice the pixel's Nyquist limit along both axes: evenly spaced up to
# the one of number COARSE, and evenly from there.
COARSE: Final = 4
FREQUENCIES: Final = np.concatenate([np.linspace(0, 0.1, COARSE + 1)[:-1], np.linspace(0.1, 2**0.5, 12)])
# Directions in which cosines run across the image, and how many pairs of point and direction are followed.
DIRECTIONS: Final = np.array([[1.0, 0.0, 0.5**0.5, 0.5**0.5], [0.0, 1.0, 0.5**0.5, -(0.5**0.5)]])
TRACKS_MAX: Final = 12
# Exact integrals take so many Gauss points in each step; a step is no longer than a quarter of a period of what shakes
# the camera, nor than it takes the image to move by a quarter of a pixel; beyond so many steps, only amplitudes count.
POINTS: Final = 4
STEPS_PER_PERIOD: Final = 4
STEP_PX: Final = 0.25
STEPS_MAX: Final = 2048
TRAVEL_STEPS: Final = 257
# Rows that are followed where rows are exposed at different times.
ROWS: Final = 5


class CollectedWaves:
    """The cosines that each mask's light collects.

    Args:
        scene: Whose near and far points are followed.
        path: Where the camera is at any time.
        slices: When light is collected through which masks, with all effects on time.
        object_px_per_s: How fast objects move by themselves, either way.
    """

    def __init__(self, scene: Scene, path: CameraPath, slices: Slices, object_px_per_s: float = 0.0) -> None:
        lit = slices.mix.any(axis=1) & (slices.stop_s > slices.start_s)
        self._scene, self._path, self._slices, self._own_px_per_s = scene, path, slices, object_px_per_s
        self._lit = lit
        self._latest: tuple[Moments, NDArray[np.complex128]] | None = None
        self._begin_s, self._end_s = float(slices.start_s[lit].min()), float(slices.stop_s[lit].max())
        # How much of each slice's light each mask passes to each row followed, [S, N, R].
        rows = np.ones((len(slices.start_s), 1))
        if slices.shutter is not None:
            height = scene.size[0]
            followed = np.unique(np.linspace(0, height - 1, ROWS).round().astype(int))
            rows = np.zeros((len(slices.start_s), len(followed)))
            rows[lit] = slices.shutter.open_share(slices.start_s[lit], slices.stop_s[lit], height)[:, followed]
        self._mix = slices.mix[:, :, None] * rows[:, None, :]

    def missed(self, moments: Moments, interval_s: float) -> F64:
        """Find what sampling at these moments gets wrong behind each mask, as a share of a wave's amplitude, [N, F].

        The most of any point and direction, and of any slower point: a cosine of lower frequency turns as little.
        """
        weights = moments.weights_s(self._slices)
        sampled = np.einsum("ks,snr->nrk", weights, self._mix, optimize=True)
        waves = self._waves_at(moments)
        apart = np.abs(self._exact - np.einsum("nrk,fkj->nrfj", sampled, waves, optimize=True)) / interval_s
        return np.asarray(np.maximum.accumulate(apart.max(axis=(1, 3)), axis=1))

    def missed_at(self, moments: Moments, times_s: F64) -> F64:
        """Find what interpolating views between these moments gets wrong at some times, [T, F], as `missed`."""
        between = np.einsum("tk,fkj->tfj", moments.interpolation(times_s), self._waves_at(moments), optimize=True)
        apart = np.abs(self._waves(times_s).transpose(1, 0, 2) - between).max(axis=2)
        return np.asarray(np.maximum.accumulate(apart, axis=1))

    @cached_property
    def _exact(self) -> NDArray[np.complex128]:
        """The waves that each mask's light collects, [N, R, F, J] seconds."""
        start, stop = self._slices.start_s[self._lit], self._slices.stop_s[self._lit]
        steps = np.maximum(np.ceil((stop - start) / self._step_s(float((stop - start).sum()))).astype(int), 1)
        first = np.cumsum(steps) - steps
        slice_of = np.repeat(np.arange(len(steps)), steps)
        length = ((stop - start) / steps)[slice_of]
        begin = start[slice_of] + length * (np.arange(len(slice_of)) - first[slice_of])
        times = (begin[:, None] + length[:, None] * gauss_nodes(POINTS)).ravel()
        waves = self._waves(times)
        parts = (length[:, None] * gauss_weights(POINTS)).ravel()[:, None] * waves
        of_slices = np.add.reduceat(parts, first * POINTS, axis=1)
        return np.asarray(np.einsum("snr,fsj->nrfj", self._mix[self._lit], of_slices, optimize=True))

    def _step_s(self, collected_s: float) -> float:
        times = np.linspace(self._begin_s, self._end_s, TRAVEL_STEPS)
        travel = image_travel_px(self._scene, self._path, times) + self._own_px_per_s * (times - times[0])
        fastest = float(np.diff(travel).max()) / float(times[1] - times[0])
        wanted = min(1 / (STEPS_PER_PERIOD * max(highest_hz(self._path), 1e-300)), STEP_PX / max(fastest, 1e-300))
        return max(wanted, collected_s / STEPS_MAX)

    @cached_property
    def _longest(self) -> NDArray[np.intp]:
        """Which pairs of point and direction move farthest: only they matter."""
        times = np.linspace(self._begin_s, self._end_s, TRAVEL_STEPS)
        ways = np.abs(np.diff(self._all_tracks(times), axis=0)).sum(axis=0)
        return np.asarray(np.argsort(ways)[-TRACKS_MAX:])

    def _waves_at(self, moments: Moments) -> NDArray[np.complex128]:
        """Return the waves at some moments, which are asked for twice."""
        if self._latest is None or self._latest[0] is not moments:
            self._latest = moments, self._waves(moments.times_s)
        return self._latest[1]

    def _waves(self, times_s: F64) -> NDArray[np.complex128]:
        """Return the waves at the points followed, [F, T, J]."""
        track = self._all_tracks(times_s)[:, self._longest]
        # Frequencies are evenly spaced in two runs: each wave is the one before times the same.
        waves = np.empty((len(FREQUENCIES), *track.shape), dtype=np.complex128)
        waves[0] = 1
        for first in (1, COARSE + 1):
            turn = np.exp(2j * np.pi * (FREQUENCIES[first] - FREQUENCIES[first - 1]) * track)
            for number in range(first, COARSE + 1 if first == 1 else len(FREQUENCIES)):
                np.multiply(waves[number - 1], turn, out=waves[number])
        return waves

    def _all_tracks(self, times_s: F64) -> F64:
        """Return where the points are along each direction, [T, J] pixels."""
        track = tracks_px(self._scene, self._path, times_s) @ DIRECTIONS
        if self._own_px_per_s:
            own = self._own_px_per_s * (times_s - 0.5 * (self._begin_s + self._end_s))[:, None, None]
            track = np.concatenate([track, track + own, track - own], axis=1)
        return np.asarray(track.reshape(len(times_s), -1))

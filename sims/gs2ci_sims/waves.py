"""The moving image's cosines, integrated over each mask's time exactly and from samples at a few moments.

The phase of a cosine across the image rotates as a point of the image moves. The times of each mask's light are known
(`signals.Slices`), and so are the weights of the rendered views (`moments.Moments`); the difference of the two
integrals is the sampling error of that cosine behind that mask. Here: these differences, for points at the nearest and
the farthest depth of the scene. Not here: the power of the cosines (`spectrum`), the choice of the moments
(`sampling`).
"""

from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci_sims.moments import Moments
from gs2ci_sims.motion import image_travel_px, tracks_px
from gs2ci_sims.path import CameraPath, highest_hz, kinks_s
from gs2ci_sims.scene import Scene
from gs2ci_sims.signals import Slices
from gs2ci_sims.spectrum import SECTORS

# Frequencies of the image, cycles per pixel, up to the limit of twice two samples per pixel side along the diagonal:
# evenly spaced up to number COARSE, and evenly with another step from there.
COARSE: Final = 4
FREQUENCIES: Final = np.concatenate([np.linspace(0, 0.1, COARSE + 1)[:-1], np.linspace(0.1, 2 * 2**0.5, 24)])
# Number of directions of cosines over a half turn, and of points that are followed along each.
DIRECTIONS: Final = 2 * SECTORS
ANGLES: Final = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
TRACKS: Final = 2
# The integrals that count as exact use this many views in each step. A step is at most a quarter of a period of the
# camera's vibration, and at most the time in which the image moves by a quarter of a pixel; with more steps than the
# maximum, only amplitudes are used.
EXACT_NODES: Final = 6
STEPS_PER_PERIOD: Final = 4
STEP_PX: Final = 0.25
STEPS_MAX: Final = 1024
TRAVEL_STEPS: Final = 257
# Number of rows that are followed if rows are exposed at different times.
ROWS: Final = 5


class CollectedWaves:
    """The cosines of the image, integrated over the light of each mask.

    Args:
        scene: The scene whose near and far points are followed.
        path: Pose of the camera at any time.
        slices: The times at which light is collected through each mask, with all effects on time.
        object_px_per_s: Speed of moving objects, in either direction.
    """

    def __init__(self, scene: Scene, path: CameraPath, slices: Slices, object_px_per_s: float = 0.0) -> None:
        lit = slices.mix.any(axis=1) & (slices.stop_s > slices.start_s)
        self._scene, self._path, self._own_px_per_s = scene, path, object_px_per_s
        self._slices = slices.only(lit)
        self._latest: tuple[Moments, NDArray[np.complex128]] | None = None
        self._begin_s, self._end_s = float(self._slices.start_s.min()), float(self._slices.stop_s.max())
        # The share of each slice's light that each mask transmits to each followed row, [S, N, R].
        rows = np.ones((len(self._slices.start_s), 1))
        if slices.shutter is not None:
            height = scene.size[0]
            followed = np.unique(np.linspace(0, height - 1, ROWS).round().astype(int))
            rows = slices.shutter.open_share(self._slices.start_s, self._slices.stop_s, height)[:, followed]
        self._mix = self._slices.mix[:, :, None] * rows[:, None, :]

    def missed(self, moments: Moments, interval_s: float) -> F64:
        """Find the errors of sampling at these moments behind each mask, as shares of amplitudes, [N, F, SECTORS].

        They are the largest over rows, points, and the directions that enclose the sector, and over slower points: a
        cosine of lower frequency rotates as little.
        """
        apart = np.abs(self._exact - self._collected(moments, self._waves_at(moments))) / interval_s
        return self._by_sector(apart.max(axis=1))

    def _by_sector(self, apart: F64) -> F64:
        """Return the largest over points and over the directions at the ends of each sector, [..., F, SECTORS]."""
        most = apart.reshape(*apart.shape[:-1], DIRECTIONS, TRACKS).max(axis=-1)
        most = np.maximum.accumulate(most, axis=-2)
        # Directions at an angle and at its opposite share a sector.
        most = np.maximum(most, most[..., -np.arange(DIRECTIONS) % DIRECTIONS])[..., : SECTORS + 1]
        return np.maximum(most[..., 1:], most[..., :-1])

    def _collected(self, moments: Moments, waves: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Integrate the waves at these moments over each mask's light in each row, [N, R, F, J] seconds."""
        count, rows = self._mix.shape[1:]
        stands_for = moments.weights_s(self._slices) @ self._mix.reshape(len(self._mix), -1)
        return np.asarray(stands_for.T @ waves.reshape(len(waves), -1)).reshape(count, rows, *waves.shape[1:])

    @cached_property
    def _exact(self) -> NDArray[np.complex128]:
        """The exact integrals of the waves over each mask's light, [N, R, F, J] seconds."""
        span_s = self._end_s - self._begin_s
        steps = int(np.ceil(span_s / max(self._step_s, span_s / STEPS_MAX)))
        edges = np.linspace(self._begin_s, self._end_s, steps + 1)
        kinks = kinks_s(self._path, self._begin_s, self._end_s)
        apart = np.abs(kinks[:, None] - edges).min(axis=1) > 1e-6 * span_s
        fine = Moments(np.unique(np.concatenate([edges, kinks[apart]])), EXACT_NODES)
        return self._collected(fine, self._waves(fine.times_s))

    @property
    def _step_s(self) -> float:
        times = np.linspace(self._begin_s, self._end_s, TRAVEL_STEPS)
        travel = image_travel_px(self._scene, self._path, times) + self._own_px_per_s * (times - times[0])
        fastest = float(np.diff(travel).max()) / float(times[1] - times[0])
        return min(1 / (STEPS_PER_PERIOD * max(highest_hz(self._path), 1e-300)), STEP_PX / max(fastest, 1e-300))

    @cached_property
    def _longest(self) -> NDArray[np.intp]:
        """The points that move farthest along each direction, [J]: only they matter."""
        times = np.linspace(self._begin_s, self._end_s, TRAVEL_STEPS)
        ways = np.abs(np.diff(self._all_tracks(times), axis=0)).sum(axis=0)
        points = np.argsort(ways, axis=0)[-TRACKS:]
        return np.asarray(points * DIRECTIONS + np.arange(DIRECTIONS)).T.ravel()

    def _waves_at(self, moments: Moments) -> NDArray[np.complex128]:
        """Return the waves at some moments, cached because they are needed twice."""
        if self._latest is None or self._latest[0] is not moments:
            self._latest = moments, self._waves(moments.times_s)
        return self._latest[1]

    def _waves(self, times_s: F64) -> NDArray[np.complex128]:
        """Return the waves at the followed points, by direction, [T, F, J]."""
        track = self._all_tracks(times_s).reshape(len(times_s), -1)[:, self._longest]
        # Frequencies are evenly spaced in two runs: each wave is the one before times a constant factor.
        waves = np.empty((len(times_s), len(FREQUENCIES), track.shape[1]), dtype=np.complex128)
        waves[:, 0] = 1
        for first in (1, COARSE + 1):
            turn = np.exp(2j * np.pi * (FREQUENCIES[first] - FREQUENCIES[first - 1]) * track)
            for number in range(first, COARSE + 1 if first == 1 else len(FREQUENCIES)):
                np.multiply(waves[:, number - 1], turn, out=waves[:, number])
        return waves

    def _all_tracks(self, times_s: F64) -> F64:
        """Return the points' positions along each direction, [T, points, DIRECTIONS] pixels."""
        track = tracks_px(self._scene, self._path, times_s) @ np.stack([np.cos(ANGLES), np.sin(ANGLES)])
        if self._own_px_per_s:
            own = self._own_px_per_s * (times_s - 0.5 * (self._begin_s + self._end_s))[:, None, None]
            track = np.concatenate([track, track + own, track - own], axis=1)
        return np.asarray(track)

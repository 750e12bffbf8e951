"""Taking pictures of the board: a suitable exposure, all mirrors open, and refusals of pictures without a board.

Here: `Pictures`, a bench with a board before it. Not here: finding corners (`board`), their evaluation (`camera`,
`stage`, the only users beside tests).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from gs2ci.core.arrays import F64, U8
from gs2ci_calibration.bench import Bench
from gs2ci_calibration.frames import by_colour
from gs2ci_calibration.geometry.board import Board, Sighting
from gs2ci_calibration.refusals import CalibrationError, Reason

BRIGHT_SHARE: Final = (0.3, 0.6)
"""Range for the board's white, as a share of the range from black to the converter's top."""
BRIGHT_QUANTILE: Final = 0.97
"""Quantile of the readings that is taken for white: white squares and margins fill at least a fifth of a view, and some
bright spots must not count."""
SMOOTH_PX: Final = 3
NO_LIGHT_DN: Final = 4.0
"""If white exceeds the reading of a closed modulator by less than this at the longest exposure, there is no light."""
HALF_LIMIT: Final = 0.56
"""Signal at half the exposure over that at the full one: above this limit, the well or the converter is full."""
FULL_SHARE: Final = 0.8
"""Share of the converter's range; pixels that read more with a closed modulator leave no room for the board's white."""
LIMITS_S: Final = (0.2e-3, 1.0)
START_S: Final = 10e-3
ROUNDS: Final = 14
MISSED_MAX: Final = 3
"""After this many pictures without a board at the start, the board counts as missing, or as another one."""
BLUR_MAX_PX: Final = 1.5
"""Largest standard deviation of the blur of edges, without the pixels' own: refocusing changes the focal length."""


@dataclass(frozen=True)
class Pictures:
    """A bench that takes pictures of a board.

    Args:
        bench: The bench.
        step: Name of the step, for messages.
        board: The board before it.
    """

    bench: Bench
    step: str
    board: Board

    def suit_exposure(self) -> float:
        """Return an exposure in seconds at which the board's white is well exposed.

        Clipping is detected by halving the exposure, which must halve the signal; so a full well below the converter's
        top is detected, too.

        Raises:
            CalibrationError: There is no light, the modulator is inverted, or white is clipped at any exposure, by
                its own light or by light that reaches the sensor past the modulator.
        """
        shortest_s, longest_s = self._limits_s()
        exposure_s = float(np.clip(START_S, shortest_s, longest_s))
        for _ in range(ROUNDS):
            signal_dn, room_dn = self._signal_dn(exposure_s)
            share = signal_dn / room_dn
            filled = 1 - room_dn / self.bench.top_dn
            if filled > FULL_SHARE and signal_dn > -NO_LIGHT_DN:
                if exposure_s <= shortest_s:
                    self._refuse_stray(filled, exposure_s)
                exposure_s = max(exposure_s * 0.25, shortest_s)
                continue
            clipped = share > BRIGHT_SHARE[0] and self._signal_dn(exposure_s / 2)[0] > HALF_LIMIT * signal_dn
            if clipped or share > BRIGHT_SHARE[1]:
                if exposure_s <= shortest_s:
                    self._refuse_bright(signal_dn, exposure_s)
                exposure_s = max(exposure_s * (0.25 if clipped else _factor(share, filled)), shortest_s)
            elif share < BRIGHT_SHARE[0] and exposure_s < longest_s:
                more = _factor(share, filled)
                if more < 1.05:
                    break
                exposure_s = min(exposure_s * more, longest_s)
            else:
                break
        self._require_light(*self._signal_dn(exposure_s), exposure_s)
        return exposure_s

    def take(self, exposure_s: float, frames: int) -> Sighting | None:
        """Take one picture, the mean of some frames, and find the board in it."""
        stack = self.bench.grab(self._open, frames=frames, exposure_s=exposure_s)
        return self.find(stack.readings[0].mean(axis=0))

    def find(self, picture: NDArray[np.floating]) -> Sighting | None:
        """Find the board in readings, [H, W]; those behind a colour filter array are made equally bright before."""
        is_mosaic = self.bench.devices.sensor.settings.format.cfa is not None
        return self.board.find(without_colours(picture) if is_mosaic else picture)

    @property
    def _open(self) -> U8:
        return self.bench.flat_pattern(is_open=True)[None]

    def _limits_s(self) -> tuple[float, float]:
        shortest_s, longest_s = self.bench.exposure_limits_s
        return max(shortest_s, LIMITS_S[0]), min(longest_s, LIMITS_S[1])

    def _signal_dn(self, exposure_s: float) -> tuple[float, float]:
        """Return by how much the modulator brightens the brighter pixels, and the range from closed to top, in DN.

        Negative if closing it brightens them.
        """
        patterns = np.stack([self.bench.flat_pattern(is_open=True), self.bench.flat_pattern(is_open=False)])
        opened, closed = self.bench.grab(patterns, frames=1, exposure_s=exposure_s).readings[:, 0]
        gain = uniform_filter(opened - closed, SMOOTH_PX)
        bright, dark = np.quantile(gain, (BRIGHT_QUANTILE, 1 - BRIGHT_QUANTILE))
        signal = float(bright if bright >= -dark else dark)
        return signal, max(self.bench.top_dn - float(np.median(closed)), 1.0)

    def _require_light(self, signal_dn: float, room_dn: float, exposure_s: float) -> None:
        if signal_dn < -NO_LIGHT_DN:
            raise CalibrationError(
                self.step,
                Reason.WRONG_POLARITY,
                f"closing the modulator makes the picture brighter by {-signal_dn:.0f} DN",
                remedy="set `invert` of [modulator], or check which way its mirrors send the light",
            )
        if signal_dn < NO_LIGHT_DN:
            raise CalibrationError(
                self.step,
                Reason.NO_LIGHT,
                f"opening the modulator adds {signal_dn:.1f} of {room_dn:.0f} DN after {exposure_s:.3g} s",
                allowed=f"{NO_LIGHT_DN:g} DN or more",
                remedy="take the lens cap off, light the board, check that the modulator lets light through",
            )

    def _refuse_stray(self, filled: float, exposure_s: float) -> None:
        raise CalibrationError(
            self.step,
            Reason.SATURATED,
            f"with the modulator closed, pixels are {filled:.0%} full after {exposure_s * 1e3:.3g} ms",
            allowed=f"up to {FULL_SHARE:.0%}",
            remedy="shield the sensor from light that does not come from the modulator, or dim it",
        )

    def _refuse_bright(self, signal_dn: float, exposure_s: float) -> None:
        raise CalibrationError(
            self.step,
            Reason.SATURATED,
            f"white reads {signal_dn:.0f} DN above black, clipped or nearly so, after {exposure_s * 1e3:.3g} ms",
            allowed="readings that follow the exposure",
            remedy="dim the light on the board or close the aperture",
        )


def without_colours(picture: NDArray[np.floating]) -> F64:
    """Return a mosaic's picture of a board, [H, W], with the same mean and spread at all places of its 2 x 2 pattern.

    The board is grey and all places see the same parts of it, so that only black level, filters and light make them
    differ. In the raw mosaic, steps from colour to colour hide the board's own edges.
    """
    values = picture.astype(np.float64)
    everywhere = np.ones(values.shape, np.bool_)
    spread = by_colour(values, everywhere, np.std)
    return (values - by_colour(values, everywhere, np.mean)) / np.where(spread > 0, spread, 1.0)


def _factor(share: float, filled: float) -> float:
    """Return the factor for the exposure that puts white in the middle of `BRIGHT_SHARE`; stray light scales, too."""
    wanted = float(np.mean(BRIGHT_SHARE))
    signal = max(share, 1e-3) * (1 - filled)
    return min(wanted / (signal + wanted * filled), FULL_SHARE / max(filled, 0.01), 16.0)


def require_any(step: str, sightings: Sequence[Sighting | None]) -> None:
    """Check that not all of the first pictures of a series miss the board.

    Raises:
        CalibrationError: They all miss it.
    """
    if len(sightings) >= MISSED_MAX and not any(sightings):
        raise CalibrationError(
            step,
            Reason.BOARD_NOT_SEEN,
            f"the board is in none of the first {len(sightings)} pictures",
            remedy="show the board, in focus and lit, and check [calibration.board] against its print",
        )


def require_sharp(step: str, sightings: Sequence[Sighting | None]) -> float:
    """Return the typical blur of the board's edges, in pixels.

    Raises:
        CalibrationError: It is too large: the camera is out of focus, or the board moved.
    """
    blurs = [sighting.blur_px for sighting in sightings if sighting is not None and not sighting.collinear]
    blur_px = float(np.median(blurs)) if blurs else 0.0
    if blur_px > BLUR_MAX_PX:
        raise CalibrationError(
            step,
            Reason.BLURRED,
            f"the board's edges are blurred by {blur_px:.2g} px (standard deviation)",
            allowed=f"{BLUR_MAX_PX:g} px",
            remedy="focus on the board, hold it still, or shorten the exposure with more light",
        )
    return blur_px

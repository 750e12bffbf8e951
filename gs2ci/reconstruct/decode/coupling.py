"""How strongly a decode couples consecutive views, chosen by held-out pixels of the measurement.

If the camera stands still, total variation along the views gains as much as 1 dB; if every pixel moves, it loses as
much. Pixels that no decode saw decide. Here: the choice.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_signed
from gs2ci.reconstruct.measurement.holdout import HELDOUT_SHARE, Holdout

COUPLINGS: Final = (0.0, 0.3, 0.6)


def choose_coupling(
    shot: Shot, settings: GapTvSettings, seed: int, candidates: Sequence[float] = COUPLINGS
) -> GapTvSettings:
    """Set the coupling with which a decode predicts held-out pixels best.

    Args:
        shot: A checked shot.
        settings: Everything but the coupling.
        seed: Of the draw of the held-out pixels.
        candidates: Couplings to try, each at the cost of one decode. The first is used if no pixel can be held out.

    Raises:
        InputError: The settings make no sense.
    """
    holdout = Holdout.of(shot, HELDOUT_SHARE, seed)
    choices = [replace(settings, coupling=coupling).check() for coupling in candidates]

    def unexplained(choice: GapTvSettings) -> float:
        return holdout.residual_rms(decode_signed(holdout.seen, choice)) or 0.0

    return min(choices, key=unexplained) if holdout.pixels.any() else choices[0]

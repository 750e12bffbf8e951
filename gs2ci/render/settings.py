"""How exactly a fast renderer works: what it may leave out for speed. Data alone.

Here: `RasterSettings`. Not here: which renderer (`backend.py`), the image model's own constants (`conventions.py`).
"""

from dataclasses import dataclass
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.render.conventions import TERMINATION_TRANSMITTANCE

# Far wider than useful: with a wider margin every Gaussian is in every list, whose memory grows with pixels ×
# Gaussians.
WIDEST_MARGIN_PX: Final = 64.0


@dataclass(frozen=True)
class RasterSettings:
    """What a backend may leave out.

    Args:
        termination_transmittance: Blending of a group of pixels may stop once all let less light through than this: a
            pixel changes by at most this share of the colour behind it. 0 blends to the end.
        relist_every: The lists of Gaussians that may touch each pixel, in depth order, are made once in so many
            renderings of one population and reused by those between. 1 reuses nothing.
        list_margin_px: If lists are reused, they are made with footprints widened by this on all sides. A wider margin
            costs time; if a Gaussian moves or grows further, parts of it are missing until the next lists.
    """

    termination_transmittance: float = TERMINATION_TRANSMITTANCE
    relist_every: int = 1
    list_margin_px: float = 1.0

    def check(self) -> "RasterSettings":
        """Return self if the numbers make sense.

        Raises:
            InputError: One of them is out of range.
        """
        if not 0 <= self.termination_transmittance < 1:
            raise InputError(
                f"termination transmittance {self.termination_transmittance}", allowed="0 or more, below 1"
            )
        if self.relist_every < 1 or not 0 <= self.list_margin_px <= WIDEST_MARGIN_PX:
            raise InputError(
                f"lists for {self.relist_every} renderings with a margin of {self.list_margin_px} px",
                allowed=f"at least 1 rendering, and a margin of 0 to {WIDEST_MARGIN_PX:g} px",
            )
        return self

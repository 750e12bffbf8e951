"""How exactly a fast renderer works: what it may leave out for speed. Data alone.

Here: `RasterSettings`. Not here: which renderer (`backend.py`), the image model's own constants (`conventions.py`).
"""

from dataclasses import dataclass
from typing import Annotated, Final

from pydantic import Field, PositiveInt

from gs2ci.core.bounds import Bounded
from gs2ci.render.conventions import TERMINATION_TRANSMITTANCE

# Far wider than useful: with a wider margin every Gaussian is in every list, whose memory grows with pixels ×
# Gaussians.
WIDEST_MARGIN_PX: Final = 64.0


@dataclass(frozen=True)
class RasterSettings(Bounded):
    """What a backend may leave out.

    Args:
        termination_transmittance: Blending of a group of pixels may stop once all let less light through than this: a
            pixel changes by at most this share of the colour behind it. 0 blends to the end.
        relist_every: The lists of Gaussians that may touch each pixel, in depth order, are made once in so many
            renderings of one population and reused by those between. 1 reuses nothing.
        list_margin_px: If lists are reused, they are made with footprints widened by this on all sides. A wider margin
            costs time; if a Gaussian moves or grows further, parts of it are missing until the next lists.
    """

    termination_transmittance: Annotated[float, Field(ge=0, lt=1)] = TERMINATION_TRANSMITTANCE
    relist_every: PositiveInt = 1
    list_margin_px: Annotated[float, Field(ge=0, le=WIDEST_MARGIN_PX)] = 1.0

"""Near and far: whether anything settles the order of depth before fits, and which order is likelier if nothing does.

If the motion is small and the field of view narrow, a scene with its depth order reversed (near and far exchanged)
moves almost like the right one. Tracks then cannot tell them apart, or all err alike if the camera model is slightly
wrong. Prior knowledge counts a little: the order in which the camera turns less is likelier, since a stage hardly
turns. A hand-held camera may turn, though, or one on a rail whose sensors are shifted: this never makes an order sure.

Here: these two questions. Not here: the tracks' preference (`geometry/path/motion.py`), the reversal and its turn
(`geometry/reversal.py`).
"""

from dataclasses import replace
from typing import Final

from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.path.validity import Criteria
from gs2ci.reconstruct.geometry.reversal import share_with_travel, turned

# The tracks' preference is as sure as a third of its errors, since they are correlated (`motion.preference`).
_TRACKS_COUNT: Final = 1 / 3


def is_open(geometry: Geometry, criteria: Criteria) -> bool:
    """Tell whether the order of a geometry's depths is in question: its path was estimated, and tracks are not sure.

    It is not if a stage gave the order: points in front of its cameras would lie behind those of the reversed path.
    """
    surely = geometry.order_errors is not None and geometry.order_errors >= criteria.order_errors
    return geometry.has_path and geometry.is_estimated and not geometry.order_given and not surely


def in_likelier_order(geometry: Geometry) -> Geometry:
    """Return a geometry whose order is open, turned over if the tracks' preference and its turning speak for it.

    Turning less counts up to one error of the tracks. `order_errors` of the result say by how many errors tracks prefer
    the order taken, 0 if they prefer the other one.
    """
    tracks, other = geometry.order_errors or 0.0, turned(geometry)
    backwards = tracks + share_with_travel(geometry) - share_with_travel(other) < 0
    errors = _TRACKS_COUNT * max(0.0, -tracks if backwards else tracks)
    return replace(other if backwards else geometry, order_errors=errors, other_order=None)

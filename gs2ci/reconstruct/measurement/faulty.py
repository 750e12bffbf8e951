"""All pixels that the measurement itself shows to be faulty, closed before anything is decoded.

Here: dead lines, then hot pixels. Not here: either search (`dead_lines`, `hot_pixels`).
"""

from gs2ci.core.findings import Findings
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.dead_lines import close_dead_lines
from gs2ci.reconstruct.measurement.hot_pixels import close_hot_pixels


def close_faulty_pixels(shot: Shot) -> tuple[Shot, Findings]:
    """Return the shot with every mask closed over dead lines and hot pixels; report which."""
    alive, dead = close_dead_lines(shot)
    sound, hot = close_hot_pixels(alive)
    return sound, (*dead, *hot)

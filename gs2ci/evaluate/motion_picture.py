"""Motion in the scene as one picture: the middle view with arrows, and the displacement over the exposure.

Not here: the estimation of motion (`gs2ci.reconstruct.hypotheses.moving`).
"""

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gs2ci.core.arrays import F32

_DPI: Final = 120
_ARROWS_ALONG: Final = 24
_WORTH_DRAWING_PX: Final = 0.5


def write_motion_picture(path: Path, view: F32, displacement: F32) -> None:
    """Draw the motion and write it as PNG.

    Args:
        path: The file.
        view: The middle view, [H, W, C], full scale 1.
        displacement: Displacement over the exposure of what each pixel shows, [H, W, 2] as (x, y) in px.
    """
    height, width = displacement.shape[:2]
    speed = np.linalg.norm(displacement, axis=2)
    figure = Figure(figsize=(11, 11 * 0.45 * height / width + 0.7), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    left.imshow(np.clip(np.broadcast_to(view, (height, width, 3)), 0, 1), interpolation="nearest")
    step = max(1, max(height, width) // _ARROWS_ALONG)
    rows, columns = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    moved = displacement[rows, columns]
    shown = np.linalg.norm(moved, axis=2) >= _WORTH_DRAWING_PX
    left.quiver(
        columns[shown], rows[shown], moved[shown][:, 0], moved[shown][:, 1],
        angles="xy", scale_units="xy", scale=1, color="#ff7a00", width=0.004,
    )  # fmt: skip
    left.set_title("the middle view, and how far things go over the exposure", fontsize=10)
    left.set_axis_off()
    most = max(float(np.quantile(speed, 0.995)), _WORTH_DRAWING_PX)
    drawn = right.imshow(speed, cmap="magma", vmin=0, vmax=most, interpolation="nearest")
    figure.colorbar(drawn, ax=right, label="px over the exposure", shrink=0.85)
    right.set_title("how far each pixel's surface moves by itself", fontsize=10)
    right.set_axis_off()
    figure.savefig(path, dpi=_DPI)

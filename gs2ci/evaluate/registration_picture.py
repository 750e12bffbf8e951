"""Where the masks were believed to be and where they are, in one picture.

    readings (a piece of the middle)   believed masks, summed   registered masks, summed   how far they moved

Here: that picture. Not here: how it was found (`gs2ci.reconstruct.registration`).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gs2ci.core.arrays import F64
from gs2ci.core.records import Shot

_DPI: Final = 120
_PIECE_PX: Final = 48
_ARROWS: Final = (7, 9)


def write_registration_picture(path: Path, given: Shot, registered: Shot, found: Mapping[str, Any]) -> None:
    """Draw a registration and write it as PNG.

    Args:
        path: Where.
        given: The measurement as it was given.
        registered: The same as it is believed after registration.
        found: The report's section on it; `placement` says where the masks lie.
    """
    figure = Figure(figsize=(15, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 4)
    pieces = {
        "measured (middle)": given.measurement.mean(axis=2, dtype=np.float64),
        "masks as believed, summed": _sum(given),
        "masks as registered, summed": _sum(registered),
    }
    for panel, (title, image) in zip(axes, pieces.items(), strict=False):
        panel.imshow(_middle(image), cmap="gray", interpolation="nearest")
        panel.set_title(title, fontsize=10)
        panel.set_axis_off()
    _draw_arrows(axes[3], given.size, found.get("placement") or {})
    figure.savefig(path, dpi=_DPI)


def displacement_px(size: tuple[int, int], placement: Mapping[str, float], places: F64) -> F64:
    """Return how far masks lie off at places (row, column), [K, 2], by a report's `placement`, as (down, right)."""
    turn = np.deg2rad(placement.get("rotation_deg", 0.0))
    scale, stretch, shear = (placement.get(name, 0.0) for name in ("scale", "stretch", "shear"))
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    matrix = rotation @ np.array([[1 + scale - stretch, shear], [shear, 1 + scale + stretch]])
    shift = np.array([placement.get("down_px", 0.0), placement.get("right_px", 0.0)])
    moved: F64 = (places - (np.array(size) - 1) / 2) @ (matrix - np.eye(2)).T + shift
    return moved


def _draw_arrows(panel: Axes, size: tuple[int, int], placement: Mapping[str, float]) -> None:
    height, width = size
    rows, columns = np.meshgrid(*(np.linspace(0, n - 1, k) for n, k in zip(size, _ARROWS, strict=True)), indexing="ij")
    places = np.stack([rows.ravel(), columns.ravel()], axis=1)
    moved = displacement_px(size, placement, places)
    longest = float(np.linalg.norm(moved, axis=1).max())
    magnified = 0.0 if longest == 0 else 0.1 * min(size) / longest
    panel.quiver(
        places[:, 1],
        places[:, 0],
        magnified * moved[:, 1],
        magnified * moved[:, 0],
        angles="xy",
        scale_units="xy",
        scale=1,
        color="tab:red",
    )
    panel.set_xlim(-0.05 * width, 1.05 * width)
    panel.set_ylim(1.05 * height, -0.05 * height)
    panel.set_aspect("equal")
    panel.set_xticks([])
    panel.set_yticks([])
    panel.set_title(f"from believed to found: up to {longest:.3g} px (arrows × {magnified:.3g})", fontsize=10)


def _sum(shot: Shot) -> F64:
    total: F64 = np.tensordot(shot.weights.astype(np.float64), shot.masks, axes=1)
    return total


def _middle(image: F64) -> F64:
    top, left = (max(0, (n - _PIECE_PX) // 2) for n in image.shape)
    return image[top : top + _PIECE_PX, left : left + _PIECE_PX]

"""The stated and the estimated positions of the masks in one picture.

    readings (a piece of the middle)   stated masks, summed   estimated masks, summed   displacement

Here: that picture. Not here: the estimation (`gs2ci.reconstruct.registration`).
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from gs2ci.core.arrays import F64
from gs2ci.core.records import Shot
from gs2ci.core.run_figures import RegistrationSection
from gs2ci.reconstruct.registration.placement import Placement

_DPI: Final = 120
_PIECE_PX: Final = 48
_ARROWS: Final = (7, 9)


def write_registration_picture(path: Path, given: Shot, registered: Shot, found: RegistrationSection) -> None:
    """Draw a registration and write it as PNG.

    Args:
        path: The file.
        given: The measurement as it was given.
        registered: The same after registration.
        found: The report's section on it; `placement` and `standard_errors` give the masks' position. Discs around the
            arrows' ends are standard errors, at the same magnification as the arrows.
    """
    figure = Figure(figsize=(15, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 4)
    pieces = {
        "measured (middle)": given.measurement.mean(axis=2, dtype=np.float64),
        "masks as stated, summed": _sum(given),
        "masks as estimated, summed": _sum(registered),
    }
    for panel, (title, image) in zip(axes, pieces.items(), strict=False):
        panel.imshow(_middle(image), cmap="gray", interpolation="nearest")
        panel.set_title(title, fontsize=10)
        panel.set_axis_off()
    _draw_arrows(axes[3], given.size, found)
    figure.savefig(path, dpi=_DPI)


def _draw_arrows(panel: Axes, size: tuple[int, int], found: RegistrationSection) -> None:
    height, width = size
    placement = Placement(**asdict(found.placement))
    rows, columns = np.meshgrid(*(np.linspace(0, n - 1, k) for n, k in zip(size, _ARROWS, strict=True)), indexing="ij")
    places = np.stack([rows.ravel(), columns.ravel()], axis=1)
    from_middle = places - (np.array(size) - 1) / 2
    moved = placement.moved_px(from_middle)
    errors = _errors_px(placement, found.standard_errors, from_middle)
    furthest = int(np.linalg.norm(moved, axis=1).argmax())
    longest = float(np.linalg.norm(moved[furthest]))
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
    if magnified:
        for place, there, error in zip(places, places + magnified * moved, magnified * errors, strict=True):
            panel.add_patch(Circle((there[1], there[0]), max(error, 0.0), color="tab:red", alpha=0.25, linewidth=0))
            panel.plot(place[1], place[0], ".", color="0.6", markersize=2)
    panel.set_title(
        f"from stated to estimated: up to {longest:.3g} ± {errors[furthest]:.2g} px (× {magnified:.3g})", fontsize=10
    )


def _errors_px(placement: Placement, errors: Mapping[str, float], places: F64) -> F64:
    """Return the standard errors of displacements, [K]: the effects of all parameters' errors in quadrature."""
    squares, found = np.zeros(len(places)), placement.moved_px(places)
    for name, error in errors.items():
        if hasattr(placement, name):
            moved = replace(placement, **{name: getattr(placement, name) + error}).moved_px(places)
            squares += ((moved - found) ** 2).sum(axis=1)
    return np.sqrt(squares)


def _sum(shot: Shot) -> F64:
    return np.tensordot(shot.weights.astype(np.float64), shot.masks, axes=1)


def _middle(image: F64) -> F64:
    top, left = (max(0, (n - _PIECE_PX) // 2) for n in image.shape)
    return image[top : top + _PIECE_PX, left : left + _PIECE_PX]

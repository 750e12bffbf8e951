"""What a run found, each in one picture: the motion in the scene, and the position of its masks.

    motion        the middle view with arrows   the displacement over the exposure
    registration  readings (a piece of the middle)   stated masks, summed   estimated masks, summed   displacement

Not here: the estimation of motion (`gs2ci.reconstruct.hypotheses.moving`) and of the masks' position
(`gs2ci.reconstruct.registration`).
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from gs2ci.core.arrays import F32, F64
from gs2ci.core.records import Shot
from gs2ci.core.run_figures import RegistrationSection
from gs2ci.reconstruct.registration.placement import Placement

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

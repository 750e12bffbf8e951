"""The single panels of a figure: an image, a map with its scale, a camera path, a curve.

Each function draws into given axes and has no state. Here too: the colours and type sizes that all figures share. Not
here: which panels a figure has (`gs2ci.evaluate.overview`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.evaluate.wording import told_apart

INK: Final = "#1a1d21"
MUTED: Final = "#6a7280"
HAIRLINE: Final = "#d4d8de"
PAPER: Final = "#f4f5f7"
ACCENT: Final = "#c8461b"
TRUTH: Final = "#2f5d8a"

TITLE_PT: Final = 11.5
LABEL_PT: Final = 10.0
TICK_PT: Final = 9.0

# With more symbols than this, they overlap in a panel of four inches.
MAX_CAMERA_SYMBOLS: Final = 8
MAX_POINT_SYMBOLS: Final = 24
# If the lateral motion is less than this share of the path's length, the camera moves forward; the page's sideways
# direction is then the camera's own x axis.
LATERAL_SHARE: Final = 0.2


@dataclass(frozen=True)
class Series:
    """One line of a chart: seconds and values, [K] each."""

    seconds: Sequence[float]
    values: Sequence[float]


def title(axes: Axes, text: str, figure_of_merit: str = "") -> None:
    """Write a panel's title above its left corner, and one figure above its right corner."""
    axes.set_title(text, loc="left", fontsize=TITLE_PT, color=INK, fontweight="bold", pad=7, parse_math=False)
    axes.set_title(figure_of_merit, loc="right", fontsize=LABEL_PT, color=MUTED, pad=7, parse_math=False)


def image(axes: Axes, picture: F32) -> None:
    """Show one image [H, W, C], clamped to [0, 1]; one channel is shown grey."""
    shown = np.clip(picture, 0, 1)
    axes.imshow(shown[..., 0] if shown.shape[2] == 1 else shown, cmap="gray", vmin=0, vmax=1)
    _stand_at_top(axes, shown.shape)
    _without_ticks(axes)


def scaled_map(
    axes: Axes,
    values: NDArray[Any],
    limits: tuple[float, float],
    *,
    colormap: str,
    reading: Callable[[float], float] = float,
) -> None:
    """Show a map with a slim scale below it.

    Args:
        axes: The axes to draw into.
        values: [H, W]; masked pixels stay pale.
        limits: The values that get the first and the last colour.
        colormap: Its name in matplotlib.
        reading: Returns the scale's label for a value of the map.
    """
    shades = colormaps[colormap].with_extremes(bad=HAIRLINE)
    shown = axes.imshow(values, cmap=shades, vmin=limits[0], vmax=limits[1])
    _stand_at_top(axes, values.shape)
    _without_ticks(axes)
    height_in = _size_inches(axes, given=False)[1]
    below = axes.inset_axes((0, -0.2 / height_in, 1, 0.09 / height_in))
    ticks = np.linspace(*limits, 5).tolist()
    bar = axes.figure.colorbar(shown, cax=below, orientation="horizontal", ticks=ticks)
    bar.outline.set_visible(False)
    below.set_xticklabels(told_apart([reading(tick) for tick in ticks], plain_number))
    below.tick_params(labelsize=TICK_PT, colors=MUTED, length=0, pad=4)
    labels = below.get_xticklabels()
    labels[0].set_horizontalalignment("left")
    labels[-1].set_horizontalalignment("right")


def message(axes: Axes, text: str) -> None:
    """Write in the middle of a panel why it is empty."""
    axes.set_facecolor(PAPER)
    axes.annotate(text, (0.5, 0.5), xycoords="axes fraction", ha="center", va="center", fontsize=LABEL_PT, color=MUTED)
    _without_ticks(axes)


def camera_path(axes: Axes, recovered: F64, truth: F64 | None) -> None:
    """Draw a camera path from above: sideways along the page, the cameras looking up it; the true one beneath.

    Args:
        axes: The axes to draw into.
        recovered: Camera-to-world poses, [N, 4, 4], OpenCV axes, in the frame of the true path if there is one.
        truth: The true path, or None.
    """
    reference = recovered if truth is None else truth
    page = seen_from_above(reference)
    origin = reference[:, :3, 3].mean(0)
    path, true_path = ((poses[:, :3, 3] - origin) @ page for poses in (recovered, reference))
    points = np.concatenate([path, true_path])
    size = 0.12 * max(float(np.ptp(points, axis=0).max()), 1e-12)
    few = len(recovered) <= MAX_POINT_SYMBOLS
    if truth is not None:
        axes.plot(*true_path.T, color=TRUTH, lw=5, alpha=0.28, solid_capstyle="round", label="true", zorder=1)
        if few:
            axes.plot(*true_path.T, ls="none", marker="o", ms=9, mfc="none", mec=TRUTH, mew=1.1, zorder=2)
    axes.plot(*path.T, color=ACCENT, lw=1.4, marker="o", ms=4 if few else 2, label="recovered", zorder=3)
    count = len(recovered)
    for index in np.unique(np.linspace(0, count - 1, min(count, MAX_CAMERA_SYMBOLS)).round().astype(int)):
        _camera_symbol(axes, path[index], recovered[index, :3, :3].T @ page, size)
    for index in sorted({0, count - 1}):
        x, y = path[index] - (0, 0.5 * size)
        axes.text(x, y, str(index + 1), fontsize=TICK_PT, color=MUTED, ha="center", va="top")
    _frame_path(axes, points, size)
    axes.set_xlabel(f"sideways, {'scene' if truth is None else 'true'} units", fontsize=LABEL_PT, color=INK)
    axes.set_ylabel("viewing direction", fontsize=LABEL_PT, color=INK)
    axes.legend(loc="lower left", ncols=2, fontsize=TICK_PT, frameon=False, labelcolor=INK, handlelength=1.4)


def time_curve(axes: Axes, course: Series, *, label: str, level: tuple[str, float] | None, log_values: bool) -> None:
    """Draw a quality against seconds on a logarithmic axis, with the last point marked.

    Args:
        axes: The axes to draw into.
        course: At least one point; times above 0.
        label: Name and unit of the values.
        level: A named value to compare with, drawn as a dashed line.
        log_values: Whether the values' axis is logarithmic too; they and the level are then above 0.
    """
    axes.plot(course.seconds, course.values, color=ACCENT, lw=2, solid_capstyle="round", solid_joinstyle="round")
    axes.plot(course.seconds[-1:], course.values[-1:], ls="none", marker="o", ms=6, color=ACCENT)
    axes.set_xscale("log")
    if log_values:
        axes.set_yscale("log")
    _widen(axes, course, level, log_values=log_values)
    if level is not None:
        _level_line(axes, *level)
    _plain_log_axis(axes.xaxis)
    if log_values:
        _plain_log_axis(axes.yaxis)
    else:
        axes.yaxis.set_major_locator(MaxNLocator(5, min_n_ticks=3))
    axes.set_xlabel("seconds since the start", fontsize=LABEL_PT, color=INK)
    axes.set_ylabel(label, fontsize=LABEL_PT, color=INK)
    _chart_frame(axes)


def plain_number(value: float, digits: int = 3) -> str:
    """Write a number to some significant digits, without an exponent if that stays short."""
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:.0f}" if 100 <= abs(rounded) < 1e5 else f"{rounded:g}"


def _level_line(axes: Axes, name: str, value: float) -> None:
    axes.axhline(value, color=MUTED, lw=1, ls=(0, (4, 3)), zorder=1)
    axes.annotate(
        name,
        (1, value),
        xycoords=("axes fraction", "data"),
        xytext=(-4, 4),
        textcoords="offset points",
        ha="right",
        va="bottom",
        fontsize=TICK_PT,
        color=MUTED,
    )


def _plain_log_axis(axis: Any) -> None:
    low, high = sorted(axis.get_view_interval())
    decades = np.log10(high / low)
    subs: tuple[float, ...]
    subs = (1, 2, 5) if decades < 2.2 else (1,)
    if decades < 0.7:
        subs = tuple(range(1, 10))
    axis.set_major_locator(LogLocator(subs=subs, numticks=9))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: plain_number(value)))


def _widen(axes: Axes, course: Series, level: tuple[str, float] | None, *, log_values: bool) -> None:
    """Set limits around all that is drawn, so that a flat curve or a single point still gets sensible axes."""
    axes.set_xlim(min(course.seconds) / 1.15, max(course.seconds) * 1.15)
    values = np.array([*course.values, *([level[1]] if level else [])], np.float64)
    if log_values:
        axes.set_ylim(values.min() / 1.25, values.max() * 1.25)
    else:
        # A quarter of a decibel at least; residuals that reach zero are far smaller, and get a share of their own.
        margin = max(0.08 * float(np.ptp(values)), min(0.25, 0.1 * float(np.abs(values).max())), 1e-9)
        axes.set_ylim(values.min() - margin, values.max() + margin)


def seen_from_above(camera_to_world: F64) -> F64:
    """Choose the page for a path [N, 4, 4]: [3, 2], along the sideways move and along the mean viewing direction."""
    centers = camera_to_world[:, :3, 3] - camera_to_world[:, :3, 3].mean(0)
    forward = _unit(camera_to_world[:, :3, 2].mean(0), fallback=camera_to_world[0, :3, 2])
    across = camera_to_world[:, :3, 0].mean(0)
    right = _unit(across - forward * (across @ forward), fallback=camera_to_world[0, :3, 0])
    sideways = centers - np.outer(centers @ forward, forward)
    _, spread, axes = np.linalg.svd(sideways, full_matrices=False)
    if spread[0] > LATERAL_SHARE * np.linalg.norm(centers):
        # The direction of the motion, oriented towards the camera's right.
        right = axes[0] if axes[0] @ right >= 0 else -axes[0]
    return np.stack([right, forward], axis=1)


def _unit(vector: F64, fallback: F64) -> F64:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else fallback / np.linalg.norm(fallback)


def _camera_symbol(axes: Axes, spot: F64, axes_on_page: F64, size: float) -> None:
    """Draw a camera's wedge, spread along its x axis; `axes_on_page` are its own axes, [3, 2]."""
    right, forward = axes_on_page[0], axes_on_page[2]
    wedge = np.stack([spot, spot + size * (forward + 0.5 * right), spot + size * (forward - 0.5 * right), spot])
    axes.fill(*wedge.T, facecolor=ACCENT, alpha=0.14, edgecolor="none", zorder=2)
    axes.plot(*wedge.T, color=ACCENT, lw=0.8, alpha=0.7, zorder=2)


def _frame_path(axes: Axes, points: F64, size: float) -> None:
    """Set limits with the same scale on both axes that fill the panel, the path in the middle."""
    width_in, height_in = _size_inches(axes)
    shape = height_in / width_in
    low, high = points.min(0), points.max(0)
    # Room for a wedge on every side, and for the legend below.
    half_width = max((high[0] - low[0]) / 2 + 1.2 * size, ((high[1] - low[1]) / 2 + 2.5 * size) / shape)
    middle = (low + high) / 2
    axes.set_xlim(middle[0] - half_width, middle[0] + half_width)
    axes.set_ylim(middle[1] - shape * half_width, middle[1] + shape * half_width)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    _chart_frame(axes)


def _stand_at_top(axes: Axes, shape: tuple[int, ...]) -> None:
    """Give an image that is slimmer than its panel white margins left and right; let a flatter one end early."""
    width_in, height_in = _size_inches(axes)
    margin = max(0.0, (shape[0] * width_in / height_in - shape[1]) / 2)
    axes.set_xlim(-0.5 - margin, shape[1] - 0.5 + margin)
    axes.set_anchor("N")


def _size_inches(axes: Axes, *, given: bool = True) -> tuple[float, float]:
    """Measure the size of the axes, or of the part that an image in them takes."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    box, (width, height) = axes.get_position(original=given), figure.get_size_inches()
    return float(box.width * width), float(box.height * height)


def _chart_frame(axes: Axes) -> None:
    axes.set_axisbelow(True)
    axes.grid(color=HAIRLINE, lw=0.7)
    axes.tick_params(labelsize=TICK_PT, colors=MUTED, length=0, pad=5, which="both")
    for name, side in axes.spines.items():
        side.set_visible(name in {"left", "bottom"})
        side.set_color(HAIRLINE)


def _without_ticks(axes: Axes) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    for side in axes.spines.values():
        side.set_visible(False)

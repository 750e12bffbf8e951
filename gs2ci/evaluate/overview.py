"""The overview picture: one run on one page.

    name, size                             the figures that matter
    measurement   decode        result     (truth)
    (error)       depth         path       accuracy against time
    notes

Here: the panels and their layout. Not here: how a panel is drawn (`gs2ci.evaluate.panels`). No global plotting state
is changed.
"""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from gs2ci.core.arrays import F32, F64
from gs2ci.core.findings import REMARK, Finding
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.evaluate import panels
from gs2ci.evaluate.report import OfViews, Report
from gs2ci.evaluate.scales import error_ceiling, inverse_depth_limits, white_level
from gs2ci.evaluate.trajectory import align

DPI: Final = 120
# All lengths in inches.
MARGIN: Final = 0.55
GAP_ACROSS: Final = 0.62
GAP_DOWN: Final = 0.66
HEADER: Final = 1.62
BELOW_CHARTS: Final = 0.62
FOOT: Final = 0.3
NOTE_LINE: Final = 0.2
STAT_GAP: Final = 0.5
CHART_INSET: Final = 0.45
# Panels have the image's shape within these limits; slimmer images stand at the top of their panel.
PANEL_WIDTHS: Final = (3.4, 4.0)
PANEL_HEIGHTS: Final = (0.7, 4.6)
CHART_HEIGHT: Final = 2.2
MAX_NOTE_LINES: Final = 6


def write_overview(path: Path, shot: Shot, result: RunResult, report: Report) -> None:
    """Draw a run's overview and write it as PNG.

    Args:
        path: The file.
        shot: The measurement, with its truth if there is one.
        result: The result of its reconstruction.
        report: The run's report (`gs2ci.evaluate.report`).
    """
    draw_overview(shot, result, report).savefig(path, dpi=DPI)


def draw_overview(shot: Shot, result: RunResult, report: Report) -> Figure:
    """Draw a run's overview.

    Args:
        shot: The measurement, with its truth if there is one.
        result: The result of its reconstruction.
        report: The run's report.
    """
    columns = 3 if shot.truth.views is None else 4
    height, width = shot.size
    panel_width = float(np.clip(PANEL_HEIGHTS[1] * width / height, *PANEL_WIDTHS))
    panel_height = float(np.clip(panel_width * height / width, *PANEL_HEIGHTS))
    notes = _note_lines(report.notes, columns * panel_width)
    page = _Page(columns, (panel_width, panel_height), len(notes))
    _header(page, report)
    panel = page.panels()
    view = result.views.shape[0] // 2
    _image_panels(panel, shot, result, report, view=view)
    _depth_panel(panel["depth"], result, report, view)
    _path_panel(panel["path"], shot, result, report)
    _curve_panel(panel["curve"], report)
    for row, line in enumerate(notes):
        bottom = FOOT + NOTE_LINE * (len(notes) - 1 - row)
        page.text(MARGIN, bottom, line, fontsize=panels.TICK_PT, color=panels.MUTED)
    return page.figure


class _Page:
    """A figure addressed in inches from its lower left corner.

    Args:
        columns: 3, or 4 if the truth is known.
        panel: Width and height of a panel, inches.
        note_lines: Lines of text at the foot.
    """

    def __init__(self, columns: int, panel: tuple[float, float], note_lines: int) -> None:
        self.columns = columns
        self.panel_width = panel[0]
        # Lower row first; it holds charts, which need some height.
        self.row_heights = (max(panel[1], CHART_HEIGHT), panel[1])
        self.foot = BELOW_CHARTS + FOOT + NOTE_LINE * note_lines
        self.width = 2 * MARGIN + columns * self.panel_width + (columns - 1) * GAP_ACROSS
        self.height = HEADER + sum(self.row_heights) + GAP_DOWN + self.foot
        self.figure = Figure(figsize=(self.width, self.height), facecolor="white")
        self.canvas = FigureCanvasAgg(self.figure)

    def text(self, left: float, bottom: float, text: str, **style: Any) -> Text:
        """Add a line of text at a place given in inches; dollar signs are escaped, not taken for mathematics."""
        return self.figure.text(left / self.width, bottom / self.height, text, parse_math=False, **style)

    def panels(self) -> dict[str, Axes]:
        """Add the panels, two rows of them."""
        upper = ["measurement", "decode", "result", "truth"][: self.columns]
        lower = ["error", "depth", "path", "curve"][4 - self.columns :]
        found = {}
        for row, names in enumerate((lower, upper)):
            for column, name in enumerate(names):
                # Charts carry the labels of their values inside their panel's width.
                inset = CHART_INSET if name in {"path", "curve"} else 0.0
                left = MARGIN + column * (self.panel_width + GAP_ACROSS) + inset
                bottom = self.foot + row * (self.row_heights[0] + GAP_DOWN)
                width = self.panel_width - inset
                found[name] = self.figure.add_axes(
                    (
                        left / self.width,
                        bottom / self.height,
                        width / self.width,
                        self.row_heights[row] / self.height,
                    )
                )
        return found

    def width_of(self, text: Text) -> float:
        """Measure a text, in inches."""
        renderer = self.canvas.get_renderer()  # type: ignore[no-untyped-call]
        return float(text.get_window_extent(renderer).width / self.figure.dpi)

    def shorten(self, text: Text, room: float) -> None:
        """Cut a text with an ellipsis until it is no wider than `room` inches."""
        whole, width = text.get_text(), self.width_of(text)
        # The share that fits is a good first guess; narrow letters at the front may let a few more in.
        length = len(whole) if width <= room else int(1.2 * len(whole) * room / width)
        while width > room and length > 0:
            length -= 1
            text.set_text(whole[:length].rstrip() + "…")
            width = self.width_of(text)


def _header(page: _Page, report: Report) -> None:
    top, right = page.height - 0.62, page.width - MARGIN
    for value, label in reversed(_headline(report)):
        number = page.text(right, top, value, fontsize=17, fontweight="bold", color=panels.INK, ha="right")
        below = page.text(right, top - 0.27, label, fontsize=panels.LABEL_PT, color=panels.MUTED, ha="right")
        right -= max(page.width_of(number), page.width_of(below)) + STAT_GAP
    room = right - MARGIN
    name = " ".join(report.name.split())
    page.shorten(page.text(MARGIN, top, name, fontsize=20, fontweight="bold", color=panels.INK), room)
    height, width = report.size
    colors = report.cfa or ("RGB" if report.channels == 3 else "mono")
    count = f"{report.gaussians:,}".replace(",", "\u2009")
    facts = [f"{report.views} views from one exposure", f"{width} × {height}", colors, f"{count} Gaussians"]
    style = {"fontsize": panels.LABEL_PT, "color": panels.MUTED}
    page.shorten(page.text(MARGIN, top - 0.27, "  ·  ".join(facts), **style), room)
    stopped = page.text(MARGIN, top - 0.5, report.stopped.sentence, **style)
    page.shorten(stopped, page.width - 2 * MARGIN)


def _headline(report: Report) -> list[tuple[str, str]]:
    """Choose the most important figures: value and label."""
    stats = []
    if report.psnr_db is not None and report.ssim is not None:
        stats += [(f"{report.psnr_db.mean:.2f} dB", "PSNR"), (f"{report.ssim.mean:.3f}", "SSIM")]
    if report.trajectory is not None and report.trajectory.nate is not None:
        stats += [(f"{report.trajectory.nate:.4f}", "nATE")]
    if report.depth is not None:
        stats += [(f"{report.depth.median_rel:.1%}", "depth error")]
    if report.psnr_db is None:
        stats += [(f"{report.residual.rms:.4f}", "residual rms")]
        stats += [] if report.heldout_rms is None else [(f"{report.heldout_rms:.4f}", "held-out rms")]
    return [*stats, (f"{report.seconds['total']:.0f} s", "in all")]


def _image_panels(panel: dict[str, Axes], shot: Shot, result: RunResult, report: Report, *, view: int) -> None:
    of_all = f"view {view + 1} of {result.views.shape[0]}"
    bright = white_level(shot.measurement)
    kind = f"{shot.cfa} mosaic" if shot.cfa else "RGB" if shot.channels == 3 else "mono"
    panels.image(panel["measurement"], shot.measurement / np.float32(bright))
    panels.title(panel["measurement"], "Measurement", f"{kind}, white at {bright:.2f}")
    panels.image(panel["decode"], result.decode[view])
    panels.title(panel["decode"], "Decode", of_all + _decibels(report.decode.psnr_db, view))
    panels.image(panel["result"], result.views[view])
    name = "Result = decode" if result.verdict == "decode" else "Result"
    panels.title(panel["result"], name, of_all + _decibels(report.psnr_db, view))
    if shot.truth.views is not None:
        panels.image(panel["truth"], shot.truth.views[view])
        panels.title(panel["truth"], "Truth", of_all)
        _error_panel(panel["error"], result.views[view], shot.truth.views[view])


def _error_panel(axes: Axes, recovered: F32, truth: F32) -> None:
    error = np.abs(np.clip(recovered, 0, 1) - np.clip(truth, 0, 1)).mean(-1)
    panels.scaled_map(axes, error, (0, error_ceiling(error)), colormap="inferno")
    panels.title(axes, "Error", "mean |result − truth|")


def _depth_panel(axes: Axes, result: RunResult, report: Report, view: int) -> None:
    depth = None if result.depth is None else result.depth[view]
    if depth is None or not (depth > 0).any():
        panels.title(axes, "Depth")
        panels.message(axes, "no depth was found")
        return
    if report.known_at_rest:
        panels.title(axes, "Depth")
        panels.message(axes, "cannot be found: the camera was at rest")
        return
    inverse = 1 / np.ma.masked_less_equal(depth.astype(np.float64), 0)
    limits = inverse_depth_limits(inverse.compressed())
    panels.scaled_map(axes, inverse, limits, colormap="viridis", reading=lambda value: 1 / value)
    units = "no path found" if report.lacks_path else report.length_unit
    panels.title(axes, "Depth", f"view {view + 1}, {units}")


def _path_panel(axes: Axes, shot: Shot, result: RunResult, report: Report) -> None:
    truth, recovered = shot.truth.world_to_camera, result.world_to_camera
    if report.known_at_rest and truth is None:
        panels.title(axes, "Camera path")
        panels.message(axes, "the camera was at rest")
        return
    if truth is None:
        panels.title(axes, "Camera path", "none found" if report.lacks_path else "from above")
        panels.camera_path(axes, _inverse(recovered), None)
        return
    errors = report.trajectory
    if errors is not None:
        nate = "" if errors.nate is None else f"nATE {errors.nate:.4f}  ·  "
        panels.title(axes, "Camera path", f"{nate}{errors.rotation_deg:.2f}°")
    panels.camera_path(axes, _inverse(align(recovered, truth).apply(recovered)), _inverse(truth))


def _curve_panel(axes: Axes, report: Report) -> None:
    decode: float | None
    if report.decode.psnr_db is not None:
        name, key, label = "Accuracy against time", "psnr_db", "PSNR, dB"
        decode = report.decode.psnr_db.mean
    else:
        name, key, label = "Held-out residual", "heldout", "held-out residual, rms"
        decode = report.residual.heldout_rms.decode
    panels.title(axes, name)
    rows = [(look.seconds, value) for look in report.curve if (value := getattr(look, key)) is not None]
    rows = [(seconds, value) for seconds, value in rows if seconds > 0]
    if not rows:
        panels.message(axes, "nothing was fitted")
        return
    course = panels.Series([seconds for seconds, _ in rows], [value for _, value in rows])
    level = None if decode is None else ("decode", decode)
    positive = min([*course.values, *([] if decode is None else [decode])]) > 0
    panels.time_curve(axes, course, label=label, level=level, log_values=key == "heldout" and positive)


def _inverse(poses: F64) -> F64:
    return np.asarray(np.linalg.inv(poses), dtype=np.float64)


def _decibels(psnr_db: OfViews | None, view: int) -> str:
    return "" if psnr_db is None else f"  ·  {psnr_db.per_view[view]:.2f} dB"


def _note_lines(notes: Sequence[Finding], room: float) -> list[str]:
    """Break the notes into lines of `room` inches, remarks last; if not all fit, a line refers to the report."""
    # 9 pt DejaVu Sans sets 14 characters to the inch.
    ranked = sorted(notes, key=lambda note: note.code.weight is REMARK)
    lines = [line for note in ranked for line in textwrap.wrap(note.sentence, width=int(room * 14))]
    if len(lines) > MAX_NOTE_LINES:
        lines = [*lines[: MAX_NOTE_LINES - 1], "More notes are in report.json."]
    return lines

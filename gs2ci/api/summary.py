"""The summary table of a run: `print_summary`, and its rows. Not here: any figure's computation."""

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from gs2ci.core.durations import spoken_duration

if TYPE_CHECKING:
    from gs2ci.evaluate.report import Report, Trajectory


def print_summary(folder: Path, console: Console | None = None) -> None:
    """Print the summary of a run: accuracy, time, paths of the pictures.

    Args:
        folder: A run folder.
        console: Where to print; standard output if None.

    Raises:
        StorageError: The folder contains no readable report.
    """
    from gs2ci.evaluate.report import read_report

    report = read_report(folder)
    console = console or Console(highlight=False)
    table = Table(
        title=Text(f"{report.name}: {report.views} views from one exposure", style="bold"),
        title_justify="left",
        show_header=False,
        box=None,
        padding=(0, 3, 0, 0),
    )
    table.add_column(style="dim", no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(style="dim")
    for row in summary_rows(report):
        table.add_row(*(Text(cell) for cell in row))
    console.print()
    console.print(table)
    console.print()
    bullet = Table(show_header=False, box=None, padding=(0, 1, 0, 0))
    for found in (report.stopped, *report.notes):
        bullet.add_row(Text("•"), Text(found.advice))
    console.print(bullet)
    console.print()
    for name, what in (
        ("report.html", "look here first"),
        ("overview.png", "the same in one picture"),
        ("scene.ply", "the Gaussians; for viewers: gs2ci export --to ply"),
        ("report.json", ""),
    ):
        line = Text(f"{Path(folder) / name}")
        console.print(line.append(f"  {what}" if what else "", style="dim"), soft_wrap=True)


def summary_rows(report: "Report") -> list[tuple[str, str, str]]:
    """Collect name, value and remark of every figure that is known."""
    rows = []
    for own, decode, name, form, unit in (
        (report.psnr_db, report.decode.psnr_db, "PSNR", "{:.2f}", " dB"),
        (report.ssim, report.decode.ssim, "SSIM", "{:.4f}", ""),
    ):
        if own is not None and decode is not None:
            values = (min(own.per_view), own.mean, max(own.per_view), decode.mean)
            low, mean, high, of_decode = (form.format(value) for value in values)
            rows.append((name, mean + unit, f"decode {of_decode}; views {low} to {high}"))
    rows += _trajectory_rows(report.trajectory)
    if report.depth is not None:
        rows.append(("depth", *report.depth.errors().in_words()))
    residual = report.residual
    rows.append(("residual", f"{residual.rms:.4f} rms", f"{residual.mean_abs:.4f} mean absolute"))
    if report.heldout_rms is not None:
        others = [(name, rms) for name, rms in residual.heldout_rms if name != report.verdict]
        remark = ", ".join(f"{name} {rms:.4f}" for name, rms in others if rms is not None)
        rows.append(("held-out", f"{report.heldout_rms:.4f} rms", remark))
    seconds = report.seconds
    told = ("registration", "decode", "geometry", "fit")
    stages = ", ".join(f"{stage} {seconds[stage]:.1f} s" for stage in told if stage in seconds)
    rows.append(("time", spoken_duration(seconds["total"]), stages))
    rows.append(("Gaussians", f"{report.gaussians}", f"peak memory {report.peak_mib:.0f} MiB"))
    return rows


def _trajectory_rows(errors: "Trajectory | None") -> list[tuple[str, str, str]]:
    if errors is None:
        return []
    rows = []
    if errors.nate is not None:
        backwards = "; the path runs backwards: inside out" if errors.reversed else ""
        rows.append(("nATE", f"{errors.nate:.4f}", f"ATE {errors.ate:.4g}{backwards}"))
    remark = "" if errors.rpe_r_deg is None else f"RPE {errors.rpe_t:.4g}, {errors.rpe_r_deg:.3f}°"
    rows.append(("rotation", f"{errors.rotation_deg:.3f}°", remark))
    return rows

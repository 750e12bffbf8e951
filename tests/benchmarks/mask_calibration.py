"""The cost of calibrated masks: error against frames and seconds, measured one by one and predicted.

Run `python -m tests.benchmarks.mask_calibration`; `--plot FILE.png` also draws error against the bench's seconds.
The same cells as `python -m tests.tables calibrate`, one seed. Seconds are the simulated
bench's own (exposures, upload, moves), not this machine's.
"""

import argparse
from pathlib import Path
from typing import Any

import matplotlib as mpl
from rich.console import Console
from rich.table import Table

from tests.tables.calibration import BENCHES, FRAMES, calibrate_masks

Rows = dict[tuple[str, bool], list[dict[str, Any]]]


def measure(only: str = "", frames: tuple[int, ...] = FRAMES) -> Rows:
    """Calibrate the benches whose names contain `only`; rows by bench and by whether masks are predicted."""
    names = [name for name in BENCHES if only in name]
    return {
        (name, fast): [calibrate_masks(name, count, fast, 0) for count in frames]
        for name in names
        for fast in (False, True)
    }


def table(rows: Rows, frames: tuple[int, ...] = FRAMES) -> Table:
    """Lay out mask error, stated error and seconds by frames."""
    shown = Table(title="mask error, % rms (stated) in bench seconds, by frames of each pattern")
    shown.add_column("bench", no_wrap=True)
    shown.add_column("masks", no_wrap=True)
    for count in frames:
        shown.add_column(str(count), justify="right", no_wrap=True)
    for (name, fast), line in rows.items():
        cells = [f"{row['mask_error_pct']:.2f} ({row['stated_pct']:.2f}) {row['seconds']:.0f} s" for row in line]
        shown.add_row(name, "predicted" if fast else "measured", *cells)
    return shown


def draw(rows: Rows, path: Path) -> None:
    """Draw error against seconds of the step, both modes of each bench in one colour."""
    mpl.use("Agg")
    from matplotlib import pyplot  # noqa: PLC0415

    figure, axes = pyplot.subplots(figsize=(8, 5), constrained_layout=True)
    names = list(dict.fromkeys(name for name, _ in rows))
    colours = dict(zip(names, pyplot.get_cmap("viridis")([0.0, 0.3, 0.6, 0.9]), strict=False))
    for (name, fast), line in rows.items():
        # A predicted mask rests on its registration, whose time counts as well.
        seconds = [row["seconds"] + (row["registration_seconds"] if fast else 0) for row in line]
        style = "s--" if fast else "o-"
        label = f"{name}, {'predicted' if fast else 'measured'}"
        axes.plot(
            seconds, [row["mask_error_pct"] for row in line], style, color=colours[name], markersize=4, label=label
        )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="time on the bench, s (of predicted masks with their registration's)",
        ylabel="mask error, % rms",
    )
    axes.axhline(1.0, color="#bbbbbb", linewidth=0.8)
    axes.grid(which="both", color="#eeeeee")
    axes.legend(fontsize=7, loc="lower left")
    figure.savefig(path, dpi=150)


def run(only: str = "", plot: Path | None = None) -> None:
    """Measure the benches whose names contain `only`, print the table, draw the plot if asked."""
    rows = measure(only)
    Console(width=150).print(table(rows))
    if plot:
        draw(rows, plot)


def main() -> None:
    """Parse the arguments and run."""
    parser = argparse.ArgumentParser(description=run.__doc__)
    parser.add_argument("--plot", type=Path, help="where to draw error against time")
    parser.add_argument("--only", default="", help="benches whose names contain this")
    arguments = parser.parse_args()
    run(arguments.only, arguments.plot)


if __name__ == "__main__":
    main()

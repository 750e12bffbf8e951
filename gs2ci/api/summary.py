"""The summary table of a run in a terminal. Not here: its rows (`gs2ci.evaluate.summary`)."""

from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text


def print_summary(folder: Path, console: Console | None = None) -> None:
    """Print the summary of a run: accuracy, time, paths of the pictures.

    Args:
        folder: A run folder.
        console: Where to print; standard output if None.

    Raises:
        StorageError: The folder contains no readable report.
    """
    from gs2ci.evaluate.pages.next_steps import from_exposures
    from gs2ci.evaluate.report import read_report
    from gs2ci.evaluate.summary import summary_rows

    report = read_report(folder)
    console = console or Console(highlight=False)
    table = Table(
        title=Text(f"{report.name}: {report.views} views {from_exposures(report)}", style="bold"),
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
        ("overview.png", "measurement, view and depth in one picture"),
        ("scene.ply", "the Gaussians; for viewers: gs2ci export --to ply"),
        ("report.json", ""),
    ):
        line = Text(f"{Path(folder) / name}")
        console.print(line.append(f"  {what}" if what else "", style="dim"), soft_wrap=True)

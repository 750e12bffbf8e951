"""`gs2ci calibrate`: measure a bench step by step into a calibration bundle.

Here: the arguments and what is shown. Not here: any measurement (`gs2ci_calibration`), the order of steps
(`gs2ci.api.rigs`).
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from gs2ci.api.display import open_display

if TYPE_CHECKING:
    from gs2ci_calibration.drift import Change
    from gs2ci_calibration.estimates import Section

Step = Literal["dark-flat", "sensor", "timing", "registration", "masks", "camera", "stage", "all", "check"]


def run(
    step: Annotated[Step, tyro.conf.Positional],
    *,
    rig: Path,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("bench.cal.h5"),
    fast: bool = False,
) -> Path:
    """Measure a bench into a calibration bundle.

    Each step asks for what it needs before the camera (lens cap, even light, board, scene), shows what it found with
    standard errors, and adds its section to the bundle; what is not good enough is refused with the reason, and the
    bundle stays as it was. `all` runs every step in order, `stage` if there is one; `check` takes a few frames and
    tells the drift since.

    Args:
        step: What to measure.
        rig: The rig file (TOML).
        out: The bundle, ends in .h5; its other sections are kept.
        fast: Predict the masks from geometry, blur and contrast instead of measuring each.

    Returns:
        The bundle.
    """
    from gs2ci.api.rigs import open_rig
    from gs2ci_calibration.bundle import check_bundle_place

    console = Console()
    if step != "check":
        check_bundle_place(out)
    with open_rig(rig) as opened, open_display() as display:
        if step == "check":
            found = opened.drift(out, progress=display)
            _print_drift(console, *found)
            return out
        opened.calibrate(out, step, fast=fast, heard=lambda section: _print_section(console, section), progress=display)
    console.print(f"bundle in [bold]{escape(str(out))}[/]", soft_wrap=True)
    return out


def _print_drift(console: Console, changes: list["Change"], notes: tuple[str, ...]) -> None:
    """Tell the drift since a calibration.

    Raises:
        CalibrationError: Something changed by more than allowed.
    """
    from gs2ci_calibration.refusals import CalibrationError, Reason

    grid = Table(box=None, pad_edge=False)
    for heading in ("since the calibration", "change ± standard error", "allowed", ""):
        grid.add_column(heading)
    for change in changes:
        unit = "" if change.unit == "1" else f" {change.unit}"
        limit = "" if change.limit is None else f"{change.limit:.3g}{unit}"
        verdict = "NO" if change.too_far else "ok" if limit else ""
        value = f"{change.value:+.3g} ± {change.error:.1g}{unit}"
        grid.add_row(change.what, value, limit, verdict, style="bold red" if change.too_far else "")
    console.print(grid)
    for note in notes:
        console.print(note, markup=False, soft_wrap=True)
    drifted = [change for change in changes if change.too_far]
    if drifted:
        steps = dict.fromkeys(change.step for change in drifted)
        raise CalibrationError(
            "check",
            Reason.DOES_NOT_FIT,
            f"{', '.join(change.what for change in drifted)} changed by more than allowed since the calibration",
            remedy=f"run `gs2ci calibrate` {', '.join(steps)} again",
        )


def _print_section(console: Console, section: "Section") -> None:
    grid = Table(box=None, pad_edge=False, title=section.name, title_justify="left", title_style="bold")
    for heading in ("found", "value ± standard error"):
        grid.add_column(heading)
    for name, estimate in section.estimates.items():
        grid.add_row(name, str(estimate))
    console.print(grid)
    for note in section.notes:
        console.print(note, markup=False, soft_wrap=True)

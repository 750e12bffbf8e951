"""`gs2ci calibrate`: measure a bench step by step into a calibration bundle.

Here: the arguments, the order of steps, what is shown. Not here: any measurement (`gs2ci_calibration`), what a bench is
(`gs2ci.rig.calibrating`).
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from gs2ci.commands.display import open_display

if TYPE_CHECKING:
    from gs2ci.rig.opening import Rig
    from gs2ci_calibration.bench import Bench
    from gs2ci_calibration.bundle import Bundle, Provenance
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
    from gs2ci.rig.calibrating import bench_of, operator_of, provenance_of
    from gs2ci.rig.opening import load_rig
    from gs2ci_calibration.bundle import Bundle, add_section, check_bundle_place, check_target, read_bundle

    console = Console()
    if step != "check":
        check_bundle_place(out)
    opened = load_rig(rig)
    devices = opened.open()
    try:
        with open_display() as display:
            operator = operator_of(opened, display.ask)
            bench = bench_of(opened, devices, operator, fast=fast, progress=display)
            if step == "check":
                found = _drift(bench, read_bundle(out), opened, provenance_of(opened, devices))
                display.finish()
                _print_drift(console, *found)
                return out
            check_target(out, provenance_of(opened, devices), step)
            for name in _every_step(bench) if step == "all" else (step,):
                known = read_bundle(out) if out.exists() else Bundle()
                section = _measured(bench, name, known)
                display.finish()
                add_section(out, section, provenance_of(opened, devices))
                _print_section(console, section)
    finally:
        devices.close()
    console.print(f"bundle in [bold]{escape(str(out))}[/]", soft_wrap=True)
    return out


def _every_step(bench: "Bench") -> list[str]:
    """Return all steps in order, without `stage` where there is none and without `timing` where nothing is timed."""
    from gs2ci_calibration.procedures import PROCEDURES

    left_out = set()
    if bench.devices.stage is None:
        bench.progress.say("the rig has no stage: its step is left out")
        left_out.add("stage")
    if bench.gated:
        bench.progress.say("the sensor exposes while its line is held: the step `timing` is left out")
        left_out.add("timing")
    return [name for name in PROCEDURES if name not in left_out]


def _measured(bench: "Bench", name: str, known: "Bundle") -> "Section":
    from gs2ci_calibration.procedures import PROCEDURES

    bench.progress.say(f"{name}:")
    return PROCEDURES[name](bench, known)


def _drift(
    bench: "Bench", bundle: "Bundle", rig: "Rig", provenance: "Provenance"
) -> tuple[list["Change"], tuple[str, ...]]:
    """Measure the drift since a calibration; return it, and what is worth knowing of how the bundle fits.

    Raises:
        CalibrationError: The bundle does not fit any more.
    """
    from gs2ci_calibration.drift import changes_since
    from gs2ci_calibration.fitting import fit

    found = fit(bundle, bench, provenance, rig.table.calibration.max_age_days)
    found.require(bundle)
    return changes_since(bench, bundle), found.notes


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

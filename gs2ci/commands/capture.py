"""`gs2ci capture`: run a bench and write its exposures into a shot file.

Here: the arguments, the plan as a table, and where the file is. Not here: any of the work (`gs2ci.api.rigs`).
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
import tyro

from gs2ci.api.display import open_display
from gs2ci.api.options import check_whole
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import print_table, say, say_what_reconstructs

if TYPE_CHECKING:
    from gs2ci.api.rigs import OpenRig
    from gs2ci.rig.recording import Prepared
    from gs2ci_drivers.plan import CapturePlan


def run(
    *,
    rig: Path,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("shot.h5"),
    dry_run: bool = False,
    shots: int | None = None,
    seed: int | None = None,
    until: str | None = None,
    overwrite: bool = False,
    calibration: Path | None = None,
    probe: bool = True,
    json: AsJson = False,
) -> Path | None:
    """Take coded exposures on the bench that a rig file describes.

    The plan is checked against the devices' limits and printed before anything moves. Each shot is written to
    NAME.partial as soon as it is taken, where it is safe if the program ends or the disk is full; the file gets its
    final name after the last shot.

    Args:
        rig: The rig file (TOML); docs/rigs has a simulated bench and a real one, with comments.
        out: The shot file to write, ends in .h5.
        dry_run: Connect, check and print the plan; move and write nothing.
        shots: Number of shots, instead of the rig file's; a longer burst is shortened to it. With --until, at most as
            many, by default 32.
        seed: Of the random masks, instead of the rig file's: fresh masks for another exposure of the same scene.
        until: Take exposures until those taken give, reconstructed together, views of 35dB or depth to 'depth 1%', by
            their standard errors; or for a time, 10min.
        overwrite: Replace a finished file of that name.
        calibration: Bundle of `gs2ci calibrate` with the masks to use, instead of the one named in [calibration].
        probe: First check with one mask that the bundle still fits; needs a lit scene at rest.

    Returns:
        The shot file; None for a dry run.
    """
    check_whole("--shots", shots, 1, remedy="leave --shots out for the rig file's number")
    from gs2ci.core.storage.sealing import check_target
    from gs2ci.rig.until import CaptureTarget
    from gs2ci_drivers.plan import Mode

    if until is not None:
        CaptureTarget.parse(until)
    if not dry_run:
        check_target(out, replace=overwrite, remedy="choose another name with -o, or add --overwrite to replace it")
    with answered(json) as answer:
        plan, count = take(
            rig,
            out,
            dry_run=dry_run,
            shots=shots,
            seed=seed,
            until=until,
            overwrite=overwrite,
            calibration=calibration,
            probe=probe,
        )
        if count and plan.settings.mode is not Mode.PER_MASK:
            say_what_reconstructs(out, count, one_scene=True)
        figures = [{"what": figure.what, "value": figure.value} for figure in plan.figures]
        answer({"file": None if dry_run else out, "shots": count, "plan": figures})
    return None if dry_run else out


def take(
    rig: Path,
    out: Path,
    *,
    dry_run: bool = False,
    shots: int | None = None,
    seed: int | None = None,
    until: str | None = None,
    overwrite: bool = False,
    calibration: Path | None = None,
    probe: bool = True,
) -> "tuple[CapturePlan, int]":
    """Take the exposures and print what came of it; return the plan and how many there are."""
    from gs2ci.api.rigs import open_rig
    from gs2ci.core.storage import count_shots
    from gs2ci.rig.until import MOST, check_judged

    with open_rig(rig) as opened:
        opened.trace_to(None if dry_run else out)
        opened.log_to(None if dry_run else out)
        with open_display() as display:
            asked = MOST if shots is None and until is not None else shots
            prepared = opened.plan(
                shots=asked, seed=seed, calibration=calibration, probe=probe and not dry_run, progress=display
            )
        _print_plan(opened, prepared)
        prepared.plan.require_sound()
        if until is not None:
            check_judged(prepared.plan)
        if dry_run:
            return prepared.plan, 0
        opened.record(out, prepared, overwrite=overwrite, saved=_say_what_can_be_saved, until=until)
    bench = opened.rig.bench
    light = bench.light if bench else None
    if light is not None and light.plans:
        last = light.plans[max(light.plans)]
        say(f"the light path {last.summary()}")
    if prepared.calibrated is not None:
        say(f"masks from {prepared.calibrated.bundle.path}")
        _say_where_masks_were(out, prepared)
    count, wanted = count_shots(out), prepared.plan.settings.shots
    if count < wanted and until is None:
        say(f"{wanted - count} of {wanted} exposures were lost; the file's events name them")
    say(f"{count} shot{'s' if count > 1 else ''} in ", out)
    return prepared.plan, count


def _say_what_can_be_saved(partial: Path) -> None:
    """Print the path of the shots that were taken before a capture ended early."""
    say(f"save the shots taken before: gs2ci recover {partial}", aside=True)


# Number of shots that are checked if there are many, the first and the last among them.
_LOOKED_AT: Final = 4


def _say_where_masks_were(out: Path, prepared: "Prepared") -> None:
    """Report how far the masks of coded shots had moved against the bundle, if reconstruction is installed here."""
    from gs2ci.core.storage import count_shots, read_shot
    from gs2ci.rig.updating import can_look, how_far_moved
    from gs2ci_drivers.plan import Mode

    if prepared.calibrated is None or prepared.plan.settings.mode is Mode.PER_MASK or not can_look():
        return
    count = count_shots(out)
    for index in sorted({round(k) for k in np.linspace(0, count - 1, min(count, _LOOKED_AT))}):
        moved = how_far_moved(read_shot(out, index), prepared.calibrated.bundle)
        if moved is None:
            said = f"shot {index + 1} does not show where its masks were"
        elif moved.otherwise:
            remedy = "run `gs2ci calibrate registration` and `masks` again"
            said = f"WARNING: shot {index + 1}: compared with the bundle, the masks {moved.otherwise}; {remedy}"
        elif moved.too_far:
            off = f"{moved.largest_px:.2f} ± {moved.error_px:.1g} px; the bundle allows"
            remedy = "`gs2ci calibrate update` corrects this"
            said = f"WARNING: shot {index + 1}: masks are displaced by up to {off} {moved.allowed_px:.2f} px; {remedy}"
        else:
            said = f"shot {index + 1}: masks within {max(moved.largest_px, 3 * moved.error_px):.2f} px of the bundle's"
        say(said, style="bold red" if said.startswith("WARNING") else "")


def _print_plan(rig: "OpenRig", prepared: "Prepared") -> None:
    from gs2ci_drivers.plan import table

    devices, stage = rig.devices, rig.devices.stage
    names = [devices.modulator.info.model, devices.sensor.info.model, stage.info.model if stage else "no stage"]
    kind = "simulated" if rig.simulated else "real"
    say("", rig.name, f" ({kind}): {', '.join(names)}")
    print_table(("plan", "value", "allowed", ""), table(prepared.plan))

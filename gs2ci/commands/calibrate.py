"""`gs2ci calibrate`: measure a bench step by step into a calibration bundle.

Here: the arguments and what is shown. Not here: any measurement (`gs2ci_calibration`), the order of steps
(`gs2ci.api.rigs`).
"""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro

from gs2ci.api.bundles import update_bundle
from gs2ci.api.display import open_display
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import print_table, say, say_next
from gs2ci.core.errors import Gs2ciError, InputError

if TYPE_CHECKING:
    from gs2ci.rig.updating import Update
    from gs2ci_calibration.drift import Change
    from gs2ci_calibration.estimates import Section

Step = Literal["dark-flat", "sensor", "registration", "masks", "camera", "stage", "timing", "all", "check", "update"]

# Of an update: a bundle and a shot.
_LEAST_FILES: Final = 2


def run(
    step: Annotated[Step, tyro.conf.Positional],
    files: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    *,
    rig: Path | None = None,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("bench.cal.h5"),
    fast: bool = False,
    json: AsJson = False,
) -> Path:
    """Calibrate a bench into a calibration bundle.

    Each step requests what it needs in front of the camera (lens cap, even light, board, scene), shows its results with
    standard errors, and adds its section to the bundle. A result that is not good enough is refused with the reason,
    and the bundle is unchanged. `all` runs every step in order, `stage` if there is one; `check` takes a few frames and
    reports the drift since. `update BUNDLE SHOT...` needs no bench: it corrects a bundle's masks from shots that were
    taken with it, and keeps the old bundle next to it.

    Args:
        step: What to measure.
        files: For update: the bundle, and the shots.
        rig: The rig file (TOML), for all but update.
        out: The bundle, ends in .h5; its other sections are kept.
        fast: Predict the masks from geometry, blur and contrast instead of measuring each.

    Returns:
        The bundle.
    """
    from gs2ci.api.rigs import open_rig
    from gs2ci_calibration.bundle import check_bundle_place

    with answered(json) as answer:
        if step == "update":
            bundle, update = _update(files)
            told = {name: estimate.record() for name, estimate in update.parameters.items()}
            answer({"bundle": bundle, **vars(update), "parameters": told})
            return bundle
        if rig is None or files:
            raise InputError(
                f"gs2ci calibrate {step}: " + ("no rig file" if rig is None else f"{files[0]} is not needed"),
                allowed="--rig RIG.toml, and files for update alone",
            )
        if step != "check":
            check_bundle_place(out)
        with open_rig(rig) as opened, open_display() as display:
            if step == "check":
                changes, notes = opened.drift(out, progress=display)
                answer({"bundle": out, "changes": [change.record() for change in changes], "notes": notes})
                _print_drift(changes, notes)
                return out
            sections: list[Section] = []

            def print_section(section: "Section") -> None:
                sections.append(section)
                rows = [(name, str(estimate)) for name, estimate in section.estimates.items()]
                print_table(("found", "value ± standard error"), rows, section.name)
                for note in section.notes:
                    say(note)

            try:
                opened.calibrate(out, step, fast=fast, on_section=print_section, progress=display)
            except (Gs2ciError, KeyboardInterrupt, SystemExit):
                from gs2ci_calibration.procedures import PROCEDURES

                done = [section.name for section in sections]
                # With a section done, devices are open.
                none = ["stage"] if done and opened.devices.stage is None else []
                left = [name for name in PROCEDURES if name not in done + none]
                if done and left:
                    again = shlex.join(["gs2ci", "calibrate", left[0], "--rig", str(rig), "-o", str(out)])
                    say("in ", out, f": {', '.join(done)}; go on with `{again}` ({', '.join(left)} are left)")
                raise
        say("bundle in ", out)
        if step == "all":
            say_next("capture", "--rig", rig, "--calibration", out, "-o", "shot.h5")
        answer({"bundle": out, "sections": [section.record() for section in sections]})
    return out


def _update(files: tuple[Path, ...]) -> "tuple[Path, Update]":
    """Correct a bundle from shots that were taken with it; return the bundle and the result.

    Raises:
        InputError: Less than a bundle and one shot.
    """
    if len(files) < _LEAST_FILES:
        raise InputError(
            f"gs2ci calibrate update with {len(files)} files", allowed="a bundle and one shot file or several"
        )
    bundle, *shots = files
    found = update_bundle(bundle, shots)
    rows = [
        (name, str(estimate), "corrected" if name in found.taken else "") for name, estimate in found.parameters.items()
    ]
    print_table(("found", "value ± standard error", ""), rows, "the masks since")
    for file in found.silent:
        say(f"{file} does not show where its masks are")
    if found.kept is None:
        say("no significant displacement of the masks from the bundle's: nothing was changed")
    else:
        say(f"masks moved by up to {found.largest_px:.3g} px, by {found.shots} shots")
        say("bundle in ", bundle, f", the old one in {found.kept}")
    return bundle, found


def _print_drift(changes: list["Change"], notes: tuple[str, ...]) -> None:
    """Report the drift since a calibration.

    Raises:
        CalibrationError: Something changed by more than allowed.
    """
    from gs2ci_calibration.procedures import PROCEDURES
    from gs2ci_calibration.refusals import CalibrationError, Reason

    rows = []
    for change in changes:
        unit = "" if change.unit == "1" else f" {change.unit}"
        limit = "" if change.limit is None else f"{change.limit:.3g}{unit}"
        verdict = "NO" if change.too_far else "ok" if limit else ""
        value = f"{change.value:+.3g} ± {change.error:.1g}{unit}"
        rows.append((change.what, value, limit, verdict))
    print_table(("since the calibration", "change ± standard error", "allowed", ""), rows)
    for note in notes:
        say(note)
    drifted = [change for change in changes if change.too_far]
    if drifted:
        steps = [name for name in PROCEDURES if name in {change.step for change in drifted}]
        update = "; or take shots with --no-probe and run `gs2ci calibrate update`" if "registration" in steps else ""
        raise CalibrationError(
            "check",
            Reason.DOES_NOT_FIT,
            f"{', '.join(change.what for change in drifted)} changed by more than allowed since the calibration",
            remedy=f"run `gs2ci calibrate` {', '.join(steps)} again{update}",
        )

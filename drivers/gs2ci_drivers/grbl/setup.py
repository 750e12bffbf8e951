"""Asking a GRBL controller what it is: `$$`, `$I`, `$N`, and what FluidNC has instead.

Here: the questions and what is refused. Not here: what the answers mean (`build`), lines (`link`).
"""

from collections.abc import Sequence
from dataclasses import replace

from gs2ci_drivers.axis import AxisInfo
from gs2ci_drivers.failures import BadReplyError, RefusedError, UnsupportedError
from gs2ci_drivers.grbl.build import LETTERS, Build, SteppedAxis, read_build
from gs2ci_drivers.grbl.link import GrblLink
from gs2ci_drivers.grbl.packets import parse_item, parse_setting, parse_startup
from gs2ci_drivers.grbl.rest import report_mm

FEED_STEP_MM_MIN = 0.001
"""Resolution of the feed that speeds are rounded to."""
NUMBERS_NEEDED = (100, 110, 120, 130)


def ask_build(link: GrblLink, device: str, axes: Sequence[str]) -> Build:
    """Ask for firmware and settings.

    Args:
        link: The controller, in Idle or Alarm.
        device: Name of the stage, for messages.
        axes: The axes in use.

    Raises:
        BadReplyError: A setting is missing.
        UnsupportedError: A startup line moves the stage.
        LinkError, RefusedError: No usable answer.
    """
    settings = dict(found for line in link.command("$$") if (found := parse_setting(line)) is not None)
    for number in NUMBERS_NEEDED:
        if number + LETTERS.index(axes[0]) not in settings:
            raise BadReplyError(device, "$$", b"", f"setting ${number} is missing", allowed="GRBL 1.1")
    told = link.command("$I")
    try:
        startup = dict(row for line in link.command("$N") if (row := parse_startup(line)) is not None)
    except RefusedError:  # FluidNC has macros instead
        startup = {}
    build = read_build(told, settings, startup)
    if build.motions():
        raise UnsupportedError(
            device,
            f"a startup line moves the stage at each reset and after homing: {', '.join(build.motions())}",
            asked="connect",
            allowed="startup lines without motion",
            remedy="clear it with $N0= (or $N1=)",
        )
    if build.family != "FluidNC":
        return build
    homing = {LETTERS.index(axis): _item(link, f"axes/{axis}/homing/mpos_mm") for axis in axes}
    homing_mm = {number: home_mm for number, home_mm in homing.items() if home_mm is not None}
    return replace(build, homing_mm=homing_mm, idle_ms=_item(link, "stepping/idle_ms"))


def _item(link: GrblLink, path: str) -> float | None:
    """Return a number of FluidNC's configuration; None where there is none: an axis without homing."""
    try:
        lines = link.command(f"$/{path}")
    except RefusedError:
        return None
    return next((found for line in lines if (found := parse_item(line, path)) is not None), None)


def axis_info(build: Build, device: str, axis: str) -> AxisInfo:
    """Return what an axis is.

    Raises:
        BadReplyError: Its settings are those of no axis.
    """
    i = LETTERS.index(axis)
    values = [build.settings.get(base + i, 0.0) for base in NUMBERS_NEEDED]
    if min(values) <= 0:
        raise BadReplyError(device, "$$", b"", f"settings of axis {axis} are not positive: {values}", allowed="above 0")
    steps_per_mm, speed_mm_min, acceleration, _ = values
    low_mm, high_mm = build.travel_mm(axis)
    kind = SteppedAxis if build.family == "grbl" else AxisInfo
    return kind(
        name=axis,
        min_mm=low_mm,
        max_mm=high_mm,
        step_mm=1.0 / steps_per_mm,
        max_speed_mm_s=speed_mm_min / 60.0,
        speed_step_mm_s=FEED_STEP_MM_MIN / 60.0,
        acceleration_mm_s2=acceleration,
        min_speed_mm_s=build.lowest_mm_s(axis),
        report_mm=report_mm(inches=build.inches),
    )

"""What to try next, and the outcome in one line, by the findings of the report.

The steps are the remedies of what the run reports as a failure or as a doubt (`gs2ci.core.findings`), and three that
follow from figures. Commands are those of `gs2ci --help`, with capitals in place of the reader's own file or number;
RUN is the folder of the run, NEW_RUN one that does not exist yet.

Not here: how steps look (`templates/pieces.html`), the possible findings and their remedies.
"""

from dataclasses import dataclass, replace
from typing import Final

from gs2ci.core.findings import FAILURE, REMARK, Code
from gs2ci.evaluate.pages.pieces import Tone
from gs2ci.evaluate.report import Report
from gs2ci.evaluate.wording import describe_number
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings

MOST_STEPS: Final = 4

# If the best evaluation of a fit is among this many last ones, it was still improving when its iterations ran out.
FRESH_LOOKS: Final = 2


@dataclass(frozen=True)
class NextStep:
    """One thing to try: what, the evidence, the command if there is one."""

    what: str
    because: str
    command: str = ""


@dataclass(frozen=True)
class Outcome:
    """The outcome in one line, and in two words."""

    headline: str
    word: str
    tone: Tone


def outcome(report: Report) -> Outcome:
    """Return what was recovered; the headline also says what was not."""
    count, source = f"{report.views} view{'s' if report.views != 1 else ''}", from_exposures(report)
    if report.verdict == "decode":
        return Outcome(f"{count} {source}; the scene does not explain them yet", "Views only", "poor")
    missing = {
        "rotation_only": "rotations alone explain the points, so depth stays open",
        "static": "the camera stood still, so depth stays open",
        "unsupported": "camera path and depth are not supported",
    }
    if report.geometry is not None and report.geometry.verdict in missing:
        return Outcome(f"{count} {source}; {missing[report.geometry.verdict]}", "Views, no depth", "mixed")
    if report.found(Code.FIT_DIVERGED):
        return Outcome(f"{count} and a scene {source}, kept from before the fit failed", "With doubts", "mixed")
    if _path_is_uncertain(report):
        return Outcome(f"{count} and a scene {source}; the camera path is uncertain", "With doubts", "mixed")
    return Outcome(f"{count}, the camera path and the scene in 3D, {source}", "Recovered", "good")


def from_exposures(report: Report) -> str:
    """Say from how many exposures a run was made."""
    return f"from {len(report.exposures)} exposures" if len(report.exposures) > 1 else "from one exposure"


def next_steps(report: Report, most: int = MOST_STEPS) -> list[NextStep]:
    """List what to try next: after failures, after doubts, and then what figures suggest.

    Args:
        report: `report.json`.
        most: Largest number of steps.
    """
    doubted = [found for found in (report.stopped, *report.notes) if found.kind.weight is not REMARK]
    ranked = sorted(doubted, key=lambda found: found.kind.weight is not FAILURE)
    # What is found in several exposures is to be mended once.
    first = {found.kind: found for found in reversed(ranked)}
    steps = [NextStep(found.kind.remedy, found.sentence) for found in ranked if first[found.kind] is found]
    for rule in (simulation_was_coarse, still_improving, look_at_it):
        step = rule(report)
        steps += [] if step is None else [step]
    if len(report.exposures) > 1:
        steps = [replace(step, what=_of_all(step.what), command=_of_all(step.command)) for step in steps]
    return steps[:most]


def _of_all(text: str) -> str:
    """Return a text whose commands reconstruct several exposures together."""
    return text.replace("gs2ci reconstruct SHOT.h5", "gs2ci reconstruct SHOTS.h5").replace(
        "gs2ci reconstruct ", "gs2ci reconstruct --together "
    )


def simulation_was_coarse(report: Report) -> NextStep | None:
    """The simulator could not keep its tolerance."""
    plan = report.simulation
    if plan is None or plan.error_dn <= plan.tolerance_dn:
        return None
    return NextStep(
        "Read these figures as those of a coarser simulation.",
        f"The error of the simulated effects is {plan.error_dn:.2g} DN rms; {plan.tolerance_dn:.2g} was requested.",
        "gs2ci plan RIG.toml",
    )


def still_improving(report: Report) -> NextStep | None:
    """The iterations ran out while the held-out pixels were still improving."""
    judged = [(look.iteration, look.heldout) for look in report.curve if look.heldout is not None]
    if [iteration for iteration, _ in judged[-2:-1]] == [iteration for iteration, _ in judged[-1:]]:
        judged = judged[:-1]  # the mean of several fits, which no iteration made
    looks = [heldout for _, heldout in judged]
    if report.stopped.code is not Code.FIT_ALL_DONE or len(looks) < 2:
        return None
    if looks.index(min(looks)) < len(looks) - FRESH_LOOKS:
        return None
    # Several exposures together are given more iterations than were asked for (`exposures.joint`).
    more = 2 * round(report.curve[-1].iteration / max(1, len(report.exposures)) ** 0.5)
    # A draft, or a short fit: the default gives it more.
    longer = f" --iterations {more}" if more > CoarseSettings().iterations else ""
    return NextStep(
        report.stopped.code.remedy,
        "The residual on held-out pixels was still decreasing at the end.",
        f"gs2ci reconstruct SHOT.h5 -o NEW_RUN{longer}",
    )


def look_at_it(report: Report) -> NextStep | None:
    """A scene with depth can be viewed from all sides."""
    if report.verdict == "decode" or report.geometry is None or report.geometry.verdict != "full":
        return None
    count = describe_number(report.gaussians)
    return NextStep("View the scene in 3D.", f"It has {count} Gaussians, in scene.ply.", "gs2ci view RUN")


def _path_is_uncertain(report: Report) -> bool:
    """Return whether the run doubts its path, or that of an exposure."""
    return any(note.kind in (Code.PATH_UNCERTAIN, Code.PATH_UNCONFIRMED) for note in report.notes)

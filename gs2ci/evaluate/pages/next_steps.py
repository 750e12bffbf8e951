"""What to try next, and the outcome in one line: the rules, each based on evidence in the report, by importance.

A rule reads the codes and figures of one report and returns a step, or None. It never guesses: all that it says is in
the report, and `because` names the evidence. Commands are those of `gs2ci --help`, with capitals in place of the
reader's own file or number; RUN is the folder of the run, NEW_RUN one that does not exist yet.

Not here: how steps look (`templates/pieces.html`), the possible findings and their remedies (`gs2ci.core.findings`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from gs2ci.core.findings import Code
from gs2ci.evaluate.pages.pieces import Tone
from gs2ci.evaluate.report import Report
from gs2ci.evaluate.wording import describe_number

MOST_STEPS: Final = 4

# If the best evaluation of a fit is among this many last ones, it was still improving when its iterations ran out.
FRESH_LOOKS: Final = 2
# Numbers of the presets, repeated here so that a page needs no solver; a test compares both: of fits that `fine`
# averages, its distance of the first Gaussians, which no option changes, and most iterations of the two.
FEW_FITS: Final = 4
FINE_STRIDE_PX: Final = 2
ITERATIONS: Final = {"standard": 400, "fine": 600}
# Share of pixels that no mask opens, from which on it is reported.
CLOSED_SHARE: Final = 0.05
# Tracks of decoded views scatter by about a pixel, and geometry refuses 2. In between, something moves, or the camera
# matrix is wrong.
REPROJECTION_PX: Final = 1.5
# Parallax by the camera's translation over the tracks' scatter; below this, noise dominates path and depth.
PARALLAX_TO_SCATTER: Final = 1.5


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
    count = f"{report.views} view{'s' if report.views != 1 else ''}"
    if report.verdict == "decode":
        return Outcome(f"{count} from one exposure; the scene does not explain them yet", "Views only", "poor")
    missing = {
        "rotation_only": "rotations alone explain the points, so depth stays open",
        "static": "the camera stood still, so depth stays open",
        "unsupported": "camera path and depth are not supported",
    }
    if report.geometry is not None and report.geometry.verdict in missing:
        return Outcome(f"{count} from one exposure; {missing[report.geometry.verdict]}", "Views, no depth", "mixed")
    if report.found(Code.FIT_DIVERGED):
        return Outcome(
            f"{count} and a scene from one exposure, kept from before the fit failed", "With doubts", "mixed"
        )
    if _path_is_uncertain(report):
        return Outcome(f"{count} and a scene from one exposure; the camera path is uncertain", "With doubts", "mixed")
    return Outcome(f"{count}, the camera path and the scene in 3D, from one exposure", "Recovered", "good")


def next_steps(report: Report, most: int = MOST_STEPS) -> list[NextStep]:
    """List what to try next, the most important first.

    Args:
        report: `report.json`.
        most: Largest number of steps.
    """
    found = [step for rule in RULES if (step := rule(report)) is not None]
    return found[:most]


def fit_failed(report: Report) -> NextStep | None:
    """The fit diverged."""
    diverged = report.found(Code.FIT_DIVERGED)
    if diverged is None:
        return None
    return NextStep(
        "Look for pixels that are defective rather than bright",
        f"{diverged.sentence} A few extreme samples or mask values can cause that.",
        "gs2ci import MEASUREMENT --bad-pixels median -o SHOT.h5",
    )


def stage_knows_the_path(report: Report) -> NextStep | None:
    """The tracks gave no path, and the poses that the stage reported were not used."""
    geometry = report.geometry
    lost = geometry is not None and geometry.asked_for == "tracks" and geometry.verdict != "full"
    if not (lost and report.measured.telemetry):
        return None
    return NextStep(
        "Start from the stage's poses",
        "The tracked points do not give a camera path, but this shot contains the poses that the stage reported.",
        "gs2ci reconstruct SHOT.h5 -o NEW_RUN --geometry auto",
    )


def camera_did_not_translate(report: Report) -> NextStep | None:
    """Depth needs parallax."""
    if report.geometry is None or report.geometry.verdict not in ("rotation_only", "static"):
        return None
    shift = _px(report.geometry.parallax_px)
    return NextStep(
        "Move the camera sideways while the masks change",
        f"The parallax between near and far was only {shift}; depth is estimated from it.",
    )


def too_little_to_track(report: Report) -> NextStep | None:
    """The decoded views do not hold enough points."""
    if report.geometry is None or report.geometry.verdict != "unsupported":
        return None
    return NextStep(
        "Check whether the decoded views show points that can be tracked",
        f"{describe_number(report.geometry.tracks)} points could be tracked, too few or too scattered for a path. "
        "More light, fewer masks in one exposure or a scene with more texture help.",
        "gs2ci decode SHOT.h5 -o DECODED",
    )


def scene_lost(report: Report) -> NextStep | None:
    """The decode explains the held-out pixels better than any scene that stands still."""
    if report.verdict != "decode" or not _has_path(report):
        return None
    heldout = report.residual.heldout_rms
    figures = f"{describe_number(heldout.decode, 3)} against {describe_number(heldout.scene, 3)}"
    return NextStep(
        "Check that only the camera moved",
        f"The decode predicts the held-out pixels better than the scene does ({figures}); a static scene cannot "
        "represent objects that move.",
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
    done = report.curve[-1].iteration
    # After a draft, more iterations are best spent by `standard`.
    preset = "fine" if report.settings.get("stride_px") == FINE_STRIDE_PX else "standard"
    named = "" if preset == "standard" else f" --preset {preset}"
    longer = "" if done < ITERATIONS[preset] else f" --iterations {2 * done}"
    return NextStep(
        "Use more iterations",
        f"The residual on held-out pixels was still decreasing after all {describe_number(done)} iterations."
        + ("" if longer else f" Preset {preset} makes up to {ITERATIONS[preset]}."),
        f"gs2ci reconstruct SHOT.h5 -o NEW_RUN{named}{longer}",
    )


def nobody_judged(report: Report) -> NextStep | None:
    """No pixel was held out, so the scene and the decode were not compared."""
    if not report.found(Code.UNJUDGED):
        return None
    return NextStep(
        "Do not rely on views and scene without a check of your own",
        "No pixel could be held out to judge them: too few are lit and unsaturated.",
    )


def focal_was_assumed(report: Report) -> NextStep | None:
    """A default or an estimated focal length stretches depth."""
    geometry = report.geometry
    if geometry is None or geometry.focal_source == "file":
        return None
    how = "assumed" if geometry.focal_source == "default" else "estimated from the tracks"
    return NextStep(
        "Give the focal length, if you know it",
        f"It was {how}: {_px(geometry.focal_px)}. A wrong focal length stretches all depths.",
        "gs2ci reconstruct SHOT.h5 -o NEW_RUN --focal-px FOCAL",
    )


def too_bright(report: Report) -> NextStep | None:
    """Saturated pixels."""
    share = report.measured.saturated_share
    if not report.found(Code.SATURATED) or share is None:
        return None
    return NextStep(
        "Use less light, or a shorter exposure",
        f"{share:.1%} of the pixels are saturated: their readings are only lower bounds.",
    )


def closed_pixels(report: Report) -> NextStep | None:
    """Pixels that no mask opens are guessed from their neighbours."""
    share = report.measured.closed_share
    if share < CLOSED_SHARE:
        return None
    return NextStep(
        "Draw masks that open every pixel at least once",
        f"{share:.0%} of the pixels were never open; there the views are interpolated from their surroundings.",
    )


def loose_tracks(report: Report) -> NextStep | None:
    """A path that explains its tracks badly."""
    error = report.geometry.reprojection_rms_px if report.geometry is not None and _has_path(report) else 0.0
    if error <= REPROJECTION_PX:
        return None
    return NextStep(
        "Check the camera matrix, and whether something in the scene moved",
        f"The reprojection error of the tracked points is {_px(error)}; about one pixel is usual.",
    )


def uncertain_path(report: Report) -> NextStep | None:
    """The tracks leave the camera path open, however well they are explained; or there are too few to tell."""
    if report.found(Code.UNIFORM_MOTION):
        return NextStep(
            "Do not rely on the camera path",
            "Too few points could be tracked to find it, so the fit started from the uniform motion that explains the "
            "measurement best. More light, fewer masks in one exposure, or a stage that reports its poses helps.",
        )
    geometry = report.geometry
    if not report.found(Code.PATH_UNCERTAIN) or geometry is None or geometry.path_error_expected is None:
        return None
    count, error = describe_number(geometry.tracks), geometry.path_error_expected
    return NextStep(
        "Do not rely on the camera path",
        f"Halves of the {count} points give different paths: the expected error of the first path is "
        f"{error:.0%} of its extent. More sideways motion, texture over more of the frame, or a stage that reports its "
        "poses helps.",
    )


def little_parallax(report: Report) -> NextStep | None:
    """Path and depth depend on a parallax that is hardly larger than the noise."""
    if report.geometry is None or not _has_path(report):
        return None
    shift, scatter = report.geometry.parallax_px, report.geometry.reprojection_rms_px
    if not shift or not scatter or shift >= PARALLAX_TO_SCATTER * scatter:
        return None
    return NextStep(
        "Move the camera further while the masks change",
        f"Its translation shifted the tracked points by {_px(shift)} rms, and their own scatter is {_px(scatter)}: "
        "camera path and depth are therefore uncertain.",
    )


def simulation_was_coarse(report: Report) -> NextStep | None:
    """The simulator could not keep its tolerance."""
    plan = report.simulation
    if plan is None or plan.error_dn <= plan.tolerance_dn:
        return None
    return NextStep(
        "Read these figures as those of a coarser simulation",
        f"The error of the simulated effects is {plan.error_dn:.2g} DN rms; {plan.tolerance_dn:.2g} was requested.",
        "gs2ci plan RIG.toml",
    )


def average_more(report: Report) -> NextStep | None:
    """Few fits were averaged, and they differ."""
    ensemble = report.ensemble
    if report.verdict != "refined" or ensemble is None or ensemble.fits >= FEW_FITS:
        return None
    differ = "" if ensemble.spread is None else f" They differ by {ensemble.spread:.2g} of a view's full scale."
    return NextStep(
        "Average more fits",
        f"The views come from {ensemble.fits}: where the measurement is ambiguous, fits differ, and their mean has a "
        f"smaller error.{differ}",
        "gs2ci reconstruct SHOT.h5 -o NEW_RUN --preset fine",
    )


def look_at_it(report: Report) -> NextStep | None:
    """A scene with depth can be viewed from all sides."""
    if report.verdict == "decode" or not _has_path(report):
        return None
    count = describe_number(report.gaussians)
    return NextStep("View the scene in 3D", f"It has {count} Gaussians, in scene.ply.", "gs2ci view RUN")


Rule = Callable[[Report], NextStep | None]
RULES: Final[tuple[Rule, ...]] = (
    fit_failed,
    stage_knows_the_path,
    camera_did_not_translate,
    too_little_to_track,
    scene_lost,
    nobody_judged,
    too_bright,
    still_improving,
    focal_was_assumed,
    loose_tracks,
    uncertain_path,
    little_parallax,
    closed_pixels,
    simulation_was_coarse,
    average_more,
    look_at_it,
)


def _has_path(report: Report) -> bool:
    """Return whether a complete camera path was found, and depth with it."""
    return report.geometry is not None and report.geometry.verdict == "full"


def _path_is_uncertain(report: Report) -> bool:
    """Return whether the run doubts its path, or has one that neither tracked points nor a stage confirm."""
    return report.found(Code.PATH_UNCERTAIN) is not None or report.found(Code.UNIFORM_MOTION) is not None


def _px(value: float) -> str:
    return f"{describe_number(value, 3)} px"

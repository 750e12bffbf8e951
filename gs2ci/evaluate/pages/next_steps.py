"""What to try next, and what came out: the rules, each from evidence in the report, in the order they are told.

A rule looks at one report and answers with a step, or with None. It never guesses: what it says it must have read
there, and `because` says what. Commands are those of `gs2ci --help`, with capitals where the reader's own file or
number belongs.

Not here: how steps look (`templates/pieces.html`).
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from gs2ci.evaluate.pages.pieces import Tone
from gs2ci.evaluate.wording import describe_number

Report = Mapping[str, Any]
MOST_STEPS: Final = 4

# A fit whose best look lies in its last so many looks was still improving when its iterations ran out.
FRESH_LOOKS: Final = 2
# Preset `fine` averages so many fits. A page is made without loading what fits: a test holds this one to the preset.
FEW_FITS: Final = 4
# Saturated pixels say only «at least», and a run doubts from the same share on; pixels that no mask opens say nothing.
SATURATED_SHARE: Final = 0.01
CLOSED_SHARE: Final = 0.05
# Tracks of decoded views scatter by about a pixel; geometry refuses 2. In between, something else moves or is wrong.
REPROJECTION_PX: Final = 1.5
# What translation explains of the tracks, against their scatter; below this, path and depth are at the noise's mercy.
PARALLAX_TO_SCATTER: Final = 1.5


@dataclass(frozen=True)
class Step:
    """One thing to try: what, the evidence, the command if there is one."""

    what: str
    because: str
    command: str = ""


@dataclass(frozen=True)
class Outcome:
    """What came out, in one line and two words."""

    headline: str
    word: str
    tone: Tone


def outcome(report: Report) -> Outcome:
    """Say what was recovered; what was not is part of the headline."""
    views, geometry = report["views"], _geometry(report)
    count = f"{views} view{'s' if views != 1 else ''}"
    if report["verdict"] == "decode":
        return Outcome(f"{count} from one exposure; the scene does not explain them yet", "Views only", "poor")
    missing = {
        "rotation_only": "rotations alone explain the points, so depth stays open",
        "static": "the camera stood still, so depth stays open",
        "unsupported": "camera path and depth are not supported",
    }
    if geometry.get("verdict") in missing:
        return Outcome(f"{count} from one exposure; {missing[geometry['verdict']]}", "Views, no depth", "mixed")
    if _ran_away(report):
        return Outcome(
            f"{count} and a scene from one exposure, kept from before the fit failed", "With doubts", "mixed"
        )
    if _path_is_uncertain(report):
        return Outcome(f"{count} and a scene from one exposure; the camera path is uncertain", "With doubts", "mixed")
    return Outcome(f"{count}, the camera path and the scene in 3D, from one exposure", "Recovered", "good")


def next_steps(report: Report, most: int = MOST_STEPS) -> list[Step]:
    """List what to try next, the most telling first.

    Args:
        report: `report.json`; keys that older reports lack are not missed.
        most: At most so many.
    """
    found = [step for rule in RULES if (step := rule(report)) is not None]
    return found[:most]


def fit_failed(report: Report) -> Step | None:
    """The fit left the finite numbers."""
    if not _ran_away(report):
        return None
    return Step(
        "Look for pixels that are broken rather than bright",
        f"The fit ended because {report['stopped_because']}; a few wild samples or masks do that.",
        "gs2ci import MEASUREMENT --bad-pixels median -o SHOT.h5",
    )


def stage_knows_the_path(report: Report) -> Step | None:
    """The tracks gave no path, and the stage, which reported one, was not asked."""
    geometry = _geometry(report)
    lost = geometry.get("asked_for") == "tracks" and geometry.get("verdict") != "full"
    if not (lost and _measured(report).get("telemetry")):
        return None
    return Step(
        "Start from the stage's poses",
        "The tracked points do not give a camera path, and this shot holds the one that the stage reported.",
        "gs2ci reconstruct SHOT.h5 -o RUN --geometry auto",
    )


def camera_did_not_translate(report: Report) -> Step | None:
    """Depth needs parallax."""
    geometry = _geometry(report)
    if geometry.get("verdict") not in ("rotation_only", "static"):
        return None
    shift = _px(geometry.get("parallax_px"))
    return Step(
        "Move the camera sideways while the masks change",
        f"Near and far shifted against each other by {shift}; depth is read from that shift.",
    )


def too_little_to_track(report: Report) -> Step | None:
    """The decoded views do not hold enough points."""
    geometry = _geometry(report)
    if geometry.get("verdict") != "unsupported":
        return None
    return Step(
        "See whether the decoded views hold anything to follow",
        f"{describe_number(geometry.get('tracks', 0))} points could be followed, too few or too scattered for a path. "
        "More light, fewer masks in one exposure or a scene with more texture help.",
        "gs2ci decode SHOT.h5 -o DECODED",
    )


def scene_lost(report: Report) -> Step | None:
    """The decode explains the held-out pixels better than any scene that stands still."""
    heldout = _heldout(report)
    if report["verdict"] != "decode" or _geometry(report).get("verdict") != "full":
        return None
    figures = f" ({_figure(heldout.get('decode'))} against {_figure(heldout.get('scene'))})"
    return Step(
        "Check that nothing but the camera moved",
        f"The decode predicts the held-out pixels better than the scene does{figures if heldout else ''}; one rigid "
        "scene cannot follow what moves in it.",
    )


def still_improving(report: Report) -> Step | None:
    """The iterations ran out while the held-out pixels were still improving."""
    judged = [row for row in report.get("curve", []) if row.get("heldout") is not None]
    if [row["iteration"] for row in judged[-2:-1]] == [row["iteration"] for row in judged[-1:]]:
        judged = judged[:-1]  # the mean of several fits, which no iteration made
    looks = [row["heldout"] for row in judged]
    if not str(report["stopped_because"]).startswith("all ") or len(looks) < 2:
        return None
    if looks.index(min(looks)) < len(looks) - FRESH_LOOKS:
        return None
    done = report["curve"][-1]["iteration"]
    return Step(
        "Let it run longer",
        f"The held-out pixels were still improving when all {describe_number(done)} iterations were done.",
        f"gs2ci reconstruct SHOT.h5 -o RUN --iterations {2 * done}",
    )


def nobody_judged(report: Report) -> Step | None:
    """No pixel was held out, so the scene and the decode were not compared."""
    heldout = _heldout(report)
    if not heldout or any(value is not None for value in heldout.values()):
        return None
    return Step(
        "Take views and scene with a grain of salt",
        "No pixel could be held out to judge them: too few are lit and unsaturated.",
    )


def focal_was_assumed(report: Report) -> Step | None:
    """A default or an estimated focal length stretches depth."""
    geometry = _geometry(report)
    source = geometry.get("focal_source")
    if source not in ("default", "estimated"):
        return None
    how = "assumed" if source == "default" else "estimated from the tracks"
    return Step(
        "Give the focal length, if you know it",
        f"It was {how}: {_px(geometry.get('focal_px'))}. Depths are true up to a stretch until it is known.",
        "gs2ci reconstruct SHOT.h5 -o RUN --focal-px FOCAL",
    )


def too_bright(report: Report) -> Step | None:
    """Saturated pixels."""
    share = _measured(report).get("saturated_share") or 0.0
    if share < SATURATED_SHARE:
        return None
    return Step(
        "Use less light, or a shorter exposure",
        f"{share:.1%} of the pixels are saturated and say only «at least».",
    )


def closed_pixels(report: Report) -> Step | None:
    """Pixels that no mask opens are guessed from their neighbours."""
    share = _measured(report).get("closed_share") or 0.0
    if share < CLOSED_SHARE:
        return None
    return Step(
        "Draw masks that open every pixel at least once",
        f"{share:.0%} of the pixels were never open; there the views follow from their surroundings.",
    )


def loose_tracks(report: Report) -> Step | None:
    """A path that explains its tracks badly."""
    geometry = _geometry(report)
    error = geometry.get("reprojection_rms_px")
    if geometry.get("verdict") != "full" or error is None or error <= REPROJECTION_PX:
        return None
    return Step(
        "Doubt the camera matrix, or the stillness of the scene",
        f"The camera path explains the tracked points to {_px(error)} only; about one is usual.",
    )


def uncertain_path(report: Report) -> Step | None:
    """The tracks leave the camera path open, however well they are explained; or there are too few to tell."""
    geometry = _geometry(report)
    if not _path_is_uncertain(report):
        return None
    if _path_is_untracked(report):
        return Step(
            "Do not rely on the camera path",
            "Too few points could be followed to find it, so that it began as the uniform motion by which the "
            "measurement is explained best. More light, fewer masks in one exposure, or a stage that reports its poses "
            "helps.",
        )
    count, error = describe_number(geometry.get("tracks")), geometry["path_error_expected"]
    return Step(
        "Do not rely on the camera path",
        f"Halves of the {count} tracked points disagree about it: the first path is expected to err by {error:.0%} of "
        "its extent. More sideways motion, texture over more of the frame, or a stage that reports its poses helps.",
    )


def little_parallax(report: Report) -> Step | None:
    """Path and depth rest on a shift that is hardly larger than the noise."""
    geometry = _geometry(report)
    shift, scatter = geometry.get("parallax_px"), geometry.get("reprojection_rms_px")
    if geometry.get("verdict") != "full" or not shift or not scatter or shift >= PARALLAX_TO_SCATTER * scatter:
        return None
    return Step(
        "Move the camera further while the masks change",
        f"Its translation shifted the tracked points by {_px(shift)} rms, and they scatter by {_px(scatter)} anyway: "
        "camera path and depth are the looser for it.",
    )


def simulation_was_coarse(report: Report) -> Step | None:
    """The simulator could not keep its tolerance."""
    plan = _plan(report)
    error, tolerance = plan.get("error_dn"), plan.get("tolerance_dn")
    if not isinstance(error, int | float) or not isinstance(tolerance, int | float) or error <= tolerance:
        return None
    return Step(
        "Read these figures as those of a coarser simulation",
        f"Its effects were simulated to {error:.2g} DN rms, {tolerance:.2g} had been asked for.",
        "gs2ci plan RIG.toml",
    )


def average_more(report: Report) -> Step | None:
    """Few fits were averaged, and they differ."""
    ensemble = _mapping(report.get("ensemble"))
    fits, spread = ensemble.get("fits"), ensemble.get("spread")
    if report["verdict"] != "refined" or not isinstance(fits, int) or fits >= FEW_FITS:
        return None
    differ = "" if not isinstance(spread, int | float) else f" They differ by {spread:.2g} of a view's full scale."
    return Step(
        "Average more fits",
        f"The views come from {fits}: what one measurement leaves open, each fills in differently.{differ}",
        "gs2ci reconstruct SHOT.h5 -o RUN --preset fine",
    )


def look_at_it(report: Report) -> Step | None:
    """A scene with depth is there to be walked around."""
    if report["verdict"] == "decode" or _geometry(report).get("verdict") != "full":
        return None
    count = describe_number(report["gaussians"])
    return Step("Walk around the scene", f"It is there in 3D: {count} Gaussians, in scene.ply.", "gs2ci view RUN")


Rule = Callable[[Report], Step | None]
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


def _ran_away(report: Report) -> bool:
    return re.match(r"numbers ran away", str(report["stopped_because"])) is not None


def _path_is_untracked(report: Report) -> bool:
    """Tell whether the path is one that no tracked points bear out and nobody reported."""
    return _geometry(report).get("method") == "uniform"


def _path_is_uncertain(report: Report) -> bool:
    """Tell whether the path is expected to err by more than the run's own criterion allows, or nobody can tell."""
    if _path_is_untracked(report):
        return True
    settings = _mapping(_mapping(report.get("settings")).get("geometry"))
    error, most = _geometry(report).get("path_error_expected"), _mapping(settings.get("criteria")).get("path_error")
    return isinstance(error, int | float) and isinstance(most, int | float) and error > most


def _geometry(report: Report) -> Mapping[str, Any]:
    return _mapping(report.get("geometry"))


def _measured(report: Report) -> Mapping[str, Any]:
    return _mapping(report.get("measured"))


def _heldout(report: Report) -> Mapping[str, Any]:
    return _mapping(_mapping(report.get("residual")).get("heldout_rms"))


def _plan(report: Report) -> Mapping[str, Any]:
    return _mapping(_mapping(report.get("provenance")).get("plan"))


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _px(value: Any) -> str:
    return f"{describe_number(value, 3)} px"


def _figure(value: Any) -> str:
    return describe_number(value, 3)

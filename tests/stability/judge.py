"""One case run end to end, and one judgement: finite, bounded, honest, no worse than the decode alone.

    expose ─► shot.h5 ─► read ─► reconstruct ─► report ─► judge

Grades state the quality of a result; problems are violations, which make the case fail:

    holds     loses at most 3 dB against the easy case of its own scene
    bends     loses more, but is still better than a uniform grey
    breaks    is no better than a uniform grey, or has its depth order reversed: the path backwards, near for far
    refused   one typed error, as the case demands

Depth has its own grade, also relative to the easy case of the same scene, because good views are not sufficient.

    holds     half of the pixels err by at most twice as much and a tenth of the depth more; the order is about as good
    bends     the errors are larger, or the order of depth is worse
    breaks    near and far are exchanged, or no depth was found where the easy case finds some
    unknown   there is no true depth, the easy case does not find it either, or the data do not determine it

If the data do not determine near and far (a camera that only rotated, hardly any parallax, a scene without texture),
any returned order is chance: the report has to state this, and the case is then graded by its views. It is also chance
if the rank correlation is no larger than chance allows, but then depth counts as lost.

Not here: which data determine the order, and what chance allows (`order`); the cases (`cases`), the table (`__main__`).
"""

import re
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import Gs2ciError
from gs2ci.core.findings import Code, Finding, Weight
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.core.storage import read_shot, write_shots
from gs2ci.evaluate.environment import peak_mib, restart_peak
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.evaluate.run_report import build_report
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from tests.stability.benches import FULL, Bench, Scale, build
from tests.stability.cases import CASES, EASY, Case
from tests.stability.order import by_chance, rank_error, unknowable
from tests.tables.order import depth_rank, inside_out

BENDS_DB = 3.0
# What the held-out pixels, some dozens on such small pictures, may err by when they choose.
WORSE_DB = 0.5
# Held-out pixels judge views that have not seen them, and those that are handed over have: what errs least then may
# leave more before (`fit/combining/combination.py`). Up to 1.06 times as much as the decode in the quick cases, 1.27
# with one coded view.
AGAINST_HELDOUT = 1.5
# More than an even grey of the right colour, by this much, counts as having seen something.
SEEN_DB = 1.0
# Families whose scenes are what is hard: the easy case of all is theirs as well.
SCENE_IS_HARD = ("scene", "high dynamic range")
# A depth whose order the easy case itself hardly knows cannot be lost.
KNOWN_RANK = 0.3
# Beyond twice the easy case's error, so much of the depth.
DEPTH_BENDS = 0.1
RANK_BENDS = 0.2
# What differs by less than this share lies at one depth.
ONE_DEPTH = 1e-3
# Far outside the range of light would be a fit that ran away, however finite.
RANGE = 5.0
SUM_TOLERANCE = 1e-4
# These explain a plane instead of depth, and no loss.
ABOUT_DEPTH = (
    Code.CAMERA_STOOD_STILL,
    Code.CAMERA_GIVEN_AT_REST,
    Code.CAMERA_ONLY_TURNED,
    Code.PARALLAX_MAY_DROWN,
    Code.DEPTH_STARTS_AS_PLANE,
)
# Who says one of these does not claim to know near from far.
ABOUT_ORDER = (*ABOUT_DEPTH, Code.DEPTH_ORDER_OPEN, Code.DEPTH_IN_NOISE)
# Sources of a path whose word a run may take where pixels cannot contradict it; that it does, its notes say.
TELL_ORDER = ("stage", "file")
# The largest shot of the suite takes a tenth of this.
READING_MIB = 512


@dataclass(frozen=True)
class Outcome:
    """What became of one case.

    Args:
        grade: "holds", "bends", "breaks" or "refused".
        psnr_db: Of the recovered views; None where there is nothing to compare with.
        decode_db: Of the decode alone.
        loss_db: Against the easy case of the same scene at the same scale.
        said: What the run said beyond what it says of the easy case.
        order: How the scene is inside out; "" if it is not, or if no truth tells.
        order_open: Why nobody could tell near from far; "" where one could.
        problems: What must not be; empty for a case that passes.
        depth_grade: "holds", "bends", "breaks" or "unknown".
        depth: What it is given for.
    """

    grade: str
    psnr_db: float | None = None
    decode_db: float | None = None
    loss_db: float | None = None
    said: tuple[str, ...] = ()
    order: str = ""
    order_open: str = ""
    problems: tuple[str, ...] = ()
    depth_grade: str = "unknown"
    depth: "DepthScore | None" = None


@dataclass(frozen=True)
class DepthScore:
    """How good a depth is.

    Args:
        median_rel: Median relative error after the median scale.
        rank: Rank correlation with the true depth.
        rank_error: Its standard error, were the depths nothing but chance.
    """

    median_rel: float
    rank: float
    rank_error: float = 0.0


def settings_for(scale: Scale) -> Settings:
    """Return the settings of a run at this scale."""
    look_every = max(10, scale.iterations // 10)
    hold_out = HoldOut(share=0.04, look_every=look_every, patience=3 * look_every, growth_patience=look_every)
    return Settings(fit=CoarseSettings(iterations=scale.iterations, densify_every=2 * look_every, hold_out=hold_out))


def judge(case: Case, scale: Scale) -> Outcome:
    """Run a case and judge what comes of it; errors of gs2ci's own kind are outcomes, any other one is a problem."""
    scale = replace(scale, size=case.size or scale.size, iterations=case.iterations or scale.iterations)
    try:
        shot, result = easy_run(case.bench.scene, scale) if case is EASY else run(case, scale)
    except MemoryError as error:
        return Outcome("refused", problems=(str(error),))
    except Gs2ciError as error:
        said = (f"{type(error).__name__}: {_without_folder(str(error))}",)
        if not case.refused:
            return Outcome("refused", said=said, problems=("refused where a result was expected",))
        return Outcome("refused", said=said, problems=unsaid(case, said))
    if case.refused:
        return Outcome(
            "holds",
            said=tuple(note.advice for note in result.notes),
            problems=("accepted where an error was expected",),
        )
    return appraise(case, shot, result, scale)


def judge_by_number(number: int) -> tuple[int, Outcome, float]:
    """Judge one case of the catalogue at leisure; also how many seconds it took. Cases do not travel between processes.

    Not in `__main__`, which a new process does not find again.
    """
    began_s = time.monotonic()
    return number, judge(CASES[number], FULL), time.monotonic() - began_s


def run(case: Case, scale: Scale) -> tuple[Shot, RunResult]:
    """Take the case the whole way; return the shot as read from its file, and what was recovered from it."""
    shot = case.change(exposed(case.bench, scale.size))
    with tempfile.TemporaryDirectory() as folder:
        path = write_shots(Path(folder) / "shot.h5", [shot])
        case.damage(path)
        shot = read_within_memory(path)
    with case.fault():
        found = reconstruct(shot, case.settings(settings_for(scale)))
    found.scene.check()
    return shot, found.result


@lru_cache(maxsize=4)
def exposed(bench: Bench, size: tuple[int, int]) -> Shot:
    """Expose a bench once for all cases that change the easy measurement by hand; what they are given is read-only."""
    shot = bench.expose(size)
    for array in (shot.measurement, shot.masks, shot.weights, shot.truth.views, shot.truth.world_to_camera):
        if array is not None:
            array.flags.writeable = False
    return shot


def read_within_memory(path: Path) -> Shot:
    """Read a file.

    Raises:
        MemoryError: Reading took more than `READING_MIB`, whether it then succeeded or not.
    """
    restarted, before = restart_peak(), peak_mib()
    try:
        return read_shot(path)
    finally:
        if restarted and peak_mib() - before > READING_MIB:
            raise MemoryError(f"reading took {peak_mib() - before:.0f} MiB")


def appraise(case: Case, shot: Shot, result: RunResult, scale: Scale) -> Outcome:
    """Grade a result and list what must not be."""
    try:
        notes = notes_of(shot, result)
    except (Gs2ciError, ValueError) as error:
        return Outcome("breaks", problems=(f"the result cannot be reported: {error}",))
    # Where the scene is what is hard, another one has to be the easy case.
    easy = easy_at(EASY.bench.scene if case.family in SCENE_IS_HARD else case.bench.scene, scale)
    beyond = beyond_easy(notes, easy)
    said = tuple(note.advice for note in beyond)
    scores, depth = _scores(case, shot, result), depth_score(case, shot, result)
    order_open = unknowable(shot, build(case.bench.scene, shot.size))
    # At a scale whose easy case is inside out itself, it is not the case that turns a scene over.
    order = "" if easy.order or order_open else order_of(shot, result, depth)
    problems = [*insane(shot, result), *unsaid(case, tuple(note.advice for note in (*notes, result.stopped)))]
    if not case.silent and not any(note.code in ABOUT_ORDER for note in notes):
        problems += unfounded(result, order, order_open, depth if easy.knows_order else None)
    found = Outcome(
        "breaks" if order else "holds",
        said=said,
        order=order,
        order_open=order_open,
        depth_grade="unknown" if order_open else grade_of_depth(depth, easy.depth, order),
        depth=depth,
    )
    if scores is None:
        return replace(found, problems=tuple(problems))
    psnr_db, decode_db, grey_db = scores
    loss_db = easy.psnr_db - psnr_db
    if decode_db > grey_db and psnr_db < decode_db - WORSE_DB:
        problems.append(f"{decode_db - psnr_db:.1f} dB worse than the decode alone")
    grade = "holds" if loss_db <= BENDS_DB else "bends" if psnr_db >= grey_db + SEEN_DB else "breaks"
    heard = [note for note in beyond if note.code not in ABOUT_DEPTH and is_a_warning(note)]
    if grade != "holds" and not heard and not case.silent and not case.says:
        problems.append(f"loses {loss_db:.1f} dB without a warning")
    grade = "breaks" if order else grade
    return replace(found, grade=grade, psnr_db=psnr_db, decode_db=decode_db, loss_db=loss_db, problems=tuple(problems))


def unfounded(result: RunResult, order: str, order_open: str, depth: DepthScore | None) -> list[str]:
    """List what a result that doubts nothing claims of near and far without grounds.

    Args:
        result: Of the run.
        order: How it is inside out, or "".
        order_open: Why nobody could know the order, or "".
        depth: Its depth, where the order could be known; else None.
    """
    if order:
        return [f"{order}, without a warning"]
    told = result.geometry is not None and result.geometry.method in TELL_ORDER
    claimed = result.depth is not None and not lies_at_one_depth(result.depth[len(result.depth) // 2])
    if order_open and claimed and not told:
        return [f"{order_open}, and an order of depth is handed over without a warning"]
    if not order_open and depth is not None and by_chance(depth.rank, depth.rank_error):
        return [f"the order of depth is chance (rank correlation {depth.rank:+.2f}), without a warning"]
    return []


def lies_at_one_depth(depth: F32) -> bool:
    """Tell whether a depth map, [H, W], claims that anything is nearer than anything else."""
    known = depth[np.isfinite(depth) & (depth > 0)]
    return known.size == 0 or float(np.ptp(known)) <= ONE_DEPTH * float(np.median(known))


def depth_score(case: Case, shot: Shot, result: RunResult) -> DepthScore | None:
    """Score the middle view's depth; None where there is none, or no true one."""
    if result.depth is None or not shot.views:
        return None
    found, true = result.depth[shot.views // 2], build(case.bench.scene, shot.size).depth
    rank = depth_rank(found, true)
    both = np.isfinite(found) & (found > 0) & np.isfinite(true) & (true > 0)
    if rank is None or not both.any():
        return None
    ratio = found[both] / true[both]
    return DepthScore(float(np.median(np.abs(ratio / np.median(ratio) - 1))), rank, rank_error(found, true))


def grade_of_depth(depth: DepthScore | None, easy: DepthScore | None, order: str) -> str:
    """Grade a depth against that of the easy case of the same scene."""
    if order:
        return "breaks"
    if easy is None or easy.rank < KNOWN_RANK:
        return "unknown"
    if depth is None:
        return "breaks"
    if depth.rank < 0:
        return "breaks"
    off = depth.median_rel > 2 * easy.median_rel + DEPTH_BENDS
    return "bends" if off or depth.rank < easy.rank - RANK_BENDS else "holds"


def order_of(shot: Shot, result: RunResult, depth: DepthScore | None) -> str:
    """Say how a result is inside out; "" if it is not, as far as the true path and more than chance tell."""
    truth = shot.truth.world_to_camera
    rotation_deg = None if truth is None else trajectory_errors(result.world_to_camera, truth).rotation_deg
    chance = depth is None or by_chance(depth.rank, depth.rank_error)
    return inside_out(rotation_deg, None if depth is None or chance else depth.rank)


def notes_of(shot: Shot, result: RunResult) -> tuple[Finding, ...]:
    """Return what the report tells the user.

    Raises:
        Gs2ciError: The result contradicts itself.
        ValueError: A figure of the report is not finite.
    """
    return tuple(build_report(shot, result.check()).notes)


def insane(shot: Shot, result: RunResult) -> list[str]:
    """List what is not bounded or contradicts itself in a result."""
    problems = []
    ceiling = RANGE * max(1.0, float(np.abs(shot.measurement).max()))
    if float(np.abs(result.views).max()) > ceiling:
        problems.append(f"views reach {np.abs(result.views).max():.3g}")
    held: Mapping[str, float | None] = dict(result.heldout_rms)
    best, alone = held[result.verdict], held["decode"]
    if best is not None and alone is not None and best > AGAINST_HELDOUT * alone:
        problems.append(f"chose {result.verdict}, which leaves {best / alone:.2f} times as much as the decode")
    error = _sum_error(shot, result)
    if error > SUM_TOLERANCE:
        problems.append(f"the predicted measurement is off from its float64 sum by {error:.1e}")
    return problems


def _sum_error(shot: Shot, result: RunResult) -> float:
    """Compare the predicted measurement with Σ w M X in float64, relative to its size; not behind a mosaic.

    Masks and weights are those that the reconstruction used, where it corrected the ones that it was given; views are
    those that the masks saw, where the camera moved meanwhile.
    """
    shot, views = result.registered or shot, result.views if result.exposed_views is None else result.exposed_views
    if shot.cfa is not None:
        return 0.0
    brightness = np.ones(shot.views) if result.brightness is None else np.array(result.brightness)
    weights = shot.masks.astype(np.float64) * (shot.weights * brightness)[:, None, None]
    exact = (weights[..., None] * views.astype(np.float64)).sum(axis=0)
    size = (weights[..., None] * np.abs(views.astype(np.float64))).sum(axis=0).max()
    return float(np.abs(exact - result.predicted_measurement).max() / max(size, np.finfo(np.float32).tiny))


def unsaid(case: Case, said: tuple[str, ...]) -> tuple[str, ...]:
    """List the phrases that a case demands and nobody said."""
    text = " ".join(said)
    return tuple(f"does not say «{phrase}»" for phrase in case.says if phrase not in text)


@dataclass(frozen=True)
class Easy:
    """What the easy case of a scene reaches at a scale.

    Args:
        psnr_db: Of its views.
        notes: What is said of it.
        order: How it is inside out itself; "" if it is not.
        depth: How good its depth is.
    """

    psnr_db: float
    notes: tuple[Finding, ...]
    order: str
    depth: DepthScore | None

    @property
    def knows_order(self) -> bool:
        """Tell whether the order of depth is known here, and could be lost."""
        return not self.order and self.depth is not None and self.depth.rank >= KNOWN_RANK


def is_a_warning(note: Finding) -> bool:
    """Tell whether a note warns of a loss: a remark does not, but for those of things that move."""
    return note.code.weight is not Weight.REMARK or note.code in (Code.SCENE_MOVES, Code.MOTION_AROUND)


def beyond_easy(notes: tuple[Finding, ...], easy: Easy) -> tuple[Finding, ...]:
    """Return the notes of a kind that the easy case does not bring."""
    common = {note.code for note in easy.notes}
    return tuple(note for note in notes if note.code not in common)


@lru_cache(maxsize=1)
def easy_run(scene: str, scale: Scale) -> tuple[Shot, RunResult]:
    """Run the easy case of a scene; the case that is easy itself is then graded against its own run."""
    return run(replace(EASY, bench=replace(EASY.bench, scene=scene)), scale)


@lru_cache(maxsize=32)
def easy_at(scene: str, scale: Scale) -> Easy:
    """Return what the easy case of a scene reaches at this scale."""
    case = replace(EASY, bench=replace(EASY.bench, scene=scene))
    shot, result = easy_run(scene, scale)
    scores = _scores(case, shot, result)
    assert scores is not None
    depth = depth_score(case, shot, result)
    return Easy(scores[0], notes_of(shot, result), order_of(shot, result, depth), depth)


def _scores(case: Case, shot: Shot, result: RunResult) -> tuple[float, float, float] | None:
    """Return the PSNR of the recovered views, of the decode, and of an even grey of the true views' mean colour."""
    truth = shot.truth.views
    if truth is None or np.abs(truth).max() > 1e3 * max(1.0, np.abs(shot.measurement).max()):
        return None
    truth = case.through_lens(truth)
    grey = np.broadcast_to(np.clip(truth, 0, 1).mean(axis=(0, 1, 2)), truth.shape).astype(np.float32)
    recovered, alone, even = (float(np.mean(psnr_per_view(v, truth))) for v in (result.views, result.decode, grey))
    return recovered, alone, even


def _without_folder(text: str) -> str:
    return re.sub(r"\S*/(?=shot\.h5)", "", text)

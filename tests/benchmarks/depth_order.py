"""The depth order recovered from small motions: right, reported as undetermined, or wrong without a report.

    python -m tests.benchmarks depth_order

Sixty measurements of random scenes, 128 × 96 px: fields of view from 10° to 60°, parallax from 1 to 20 px, on a
simulated bench or of a light field's rail, whose cameras stay parallel and whose sensors may be shifted so that a plane
stays fixed in the image. For each: the result of the tracks, the certainty of the order in standard errors, the rank
correlation of depth with the truth by the tracks and of the finished scene, and the finding in the report. One
reconstruction per core, one thread each. `GS2CI_BEFORE_THE_FIT=1` stops at the order with which fits begin, and takes
a tenth of the time; `GS2CI_SEED` draws other measurements.
"""

import os
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import torch

from gs2ci.core.findings import Code
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot, Truth
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.first_look import look_closer
from gs2ci.reconstruct.fit.combining.refinement import Refinement
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.prior import Request, from_tracks
from gs2ci.reconstruct.hypotheses.findings import order_findings
from gs2ci.reconstruct.hypotheses.fitting import Fits
from gs2ci.reconstruct.measurement.faulty import fill_holes
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci.reconstruct.stopwatch import Stopwatch
from gs2ci.render.backend import load_backend
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.light_path import sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import stage_move_for_parallax
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.sensor import SensorFigures
from tests.exposing import expose
from tests.processes import side_by_side
from tests.tables.order import depth_rank

SIZE = (96, 128)
VIEWS = 8
COUNT = 60
SEED = int(os.environ.get("GS2CI_SEED", "0"))
BEFORE_THE_FIT = os.environ.get("GS2CI_BEFORE_THE_FIT") == "1"
INTERVAL_S = 0.02
WELL_SHARE = 0.4
KINDS = ("bench", "rail", "shifted rail")
SAID_OPEN = (
    Code.DEPTH_ORDER_OPEN,
    Code.DEPTH_IN_NOISE,
    Code.DEPTH_STARTS_AS_PLANE,
)


@dataclass(frozen=True)
class Trial:
    """One measurement, and the scene that it shows.

    Args:
        kind: One of `KINDS`.
        field_of_view_deg: Horizontally.
        parallax_px: How far near and far shift against each other from the first view to the last.
        shot: The measurement.
        scene: With its true depth.
    """

    kind: str
    field_of_view_deg: float
    parallax_px: float
    shot: Shot
    scene: Scene


def run() -> None:
    """Reconstruct every trial by the default settings, and count."""
    counts: Counter[str] = Counter()
    print(f"{'':40} {'tracks':>13} {'errors':>6} {'before':>6} {'after':>6}")
    for line, outcome in side_by_side(judge, range(COUNT)):
        counts[outcome] += 1
        print(line, flush=True)
    print(", ".join(f"{outcome}: {count}" for outcome, count in sorted(counts.items())))


def judge(number: int) -> tuple[str, str]:
    """Reconstruct a trial; return its line of the table, and the outcome that is counted."""
    trial = draw(number, SEED)
    before = _first(trial)
    if BEFORE_THE_FIT:
        geometry = _settled(trial)
        verdict, errors, notes = geometry.verdict, geometry.order_errors, geometry.notes
        after = depth_rank(1 / geometry.inverse_depth, trial.scene.depth) if verdict == "full" else None
    else:
        found = reconstruct(trial.shot).result
        verdict, errors, notes = str(found.geometry.verdict), found.geometry.order_errors, found.notes
        after = None if found.depth is None else depth_rank(found.depth[trial.shot.views // 2], trial.scene.depth)
    outcome = _outcome(after, said_open=any(note.code in SAID_OPEN for note in notes))
    what = f"{trial.kind}, {trial.field_of_view_deg:.0f}°, {trial.parallax_px:.1f} px"
    figures = " ".join(_figure(figure) for figure in (errors, before, after))
    return f"{what:40} {verdict:>13} {figures} {outcome}", outcome


def _settled(trial: Trial) -> Geometry:
    """Return the geometry with which the fits would begin, its order settled."""
    settings, silent = Settings(), Silent()
    holdout = Holdout.of(trial.shot.check(), settings.fit.hold_out.share, settings.seed)
    prior = load_geometry_prior(settings.poses)
    first = look_closer(holdout, None, prior, settings, silent, lambda _: None, trial.shot)
    fitted = Holdout(fill_holes(first.holdout.shot, first.decoded), first.holdout.pixels)
    refine = Refinement(first.holdout, settings.residual)
    fits = Fits(first.holdout, fitted, None, settings, refine, silent, Stopwatch())
    settled, order = fits.order_of(first)
    geometry = settled.geometry
    return replace(geometry, notes=(*geometry.notes, *order_findings(order, geometry)))


def _outcome(rank: float | None, *, said_open: bool) -> str:
    right = rank is not None and rank > 0
    if said_open:
        return f"open ({'right' if right else 'wrong'})"
    return "right" if right else "wrong, not reported"


def _first(trial: Trial) -> float | None:
    """Return the rank correlation of the depth that tracks alone find; None where they find none."""
    settings = Settings()
    seen = Holdout.of(trial.shot, settings.fit.hold_out.share, settings.seed).seen
    request = Request.of(seen, gap_tv(seen, settings.decode, Silent()), settings.geometry, None)
    found = from_tracks(request, Silent())
    return None if found.verdict != "full" else depth_rank(1 / found.inverse_depth, trial.scene.depth)


def _figure(value: object) -> str:
    return f"{value:+6.2f}" if isinstance(value, float) else f"{'–':>6}"


def draw(number: int, seed: int = 0) -> Trial:
    """Draw a measurement: kinds in turn, fields of view evenly, parallaxes evenly in their logarithm."""
    rng = np.random.default_rng([seed, number])
    field_of_view_deg = float(rng.uniform(10, 60))
    parallax_px = float(np.exp(rng.uniform(np.log(1), np.log(20))))
    kind = KINDS[number % len(KINDS)]
    scene = random_scene(rng, field_of_view_deg)
    shot = (
        on_a_bench(scene, parallax_px, rng)
        if kind == "bench"
        else on_a_rail(scene, parallax_px, rng, shifted=kind == KINDS[2])
    )
    return Trial(kind, field_of_view_deg, parallax_px, shot, scene)


def random_scene(rng: np.random.Generator, field_of_view_deg: float) -> Scene:
    """Draw tilted rectangles and boxes before a backdrop, from a shallow to a deep room."""
    backdrop = 5.0
    nearest = float(rng.uniform(0.3, 0.75)) * backdrop
    depths = tuple(np.sort(rng.uniform(nearest, 0.95 * backdrop, rng.integers(2, 7))).tolist())
    return planes(
        rng, SIZE, depths=depths, backdrop=backdrop, boxes=int(rng.integers(0, 3)), field_of_view_deg=field_of_view_deg
    )


def on_a_bench(scene: Scene, parallax_px: float, rng: np.random.Generator) -> Shot:
    """Expose a scene on the simulated bench, a stage moving the camera in a random direction."""
    sensor = SensorFigures()
    photons = WELL_SHARE * sensor.full_well_e / sensor.quantum_efficiency / (VIEWS / 4)
    rig = RigFigures(
        light=Light(photons),
        modulator=ModulatorFigures(masks=VIEWS, open_share=0.25),
        timing=Timing(INTERVAL_S),
        sensor=sensor,
    )
    angle = rng.uniform(0, 2 * np.pi)
    direction = (float(np.cos(angle)), float(np.sin(angle)), float(rng.uniform(-0.3, 0.3)))
    path = stage_move_for_parallax(scene, parallax_px, rig.exposure_s, direction=direction, wobble_deg=0.02)
    seed = int(rng.integers(2**31))
    return expose(
        scene,
        path,
        random_masks(VIEWS, SIZE, 0.25, rng),
        rig,
        effects=(MotionBlur(), *sensor_effects(sensor)),
        seed=seed,
    )


def on_a_rail(
    scene: Scene, parallax_px: float, rng: np.random.Generator, *, shifted: bool, noise: float = 0.005
) -> Shot:
    """Code the views of parallel cameras along a straight rail, as of a light field.

    Args:
        scene: What they see.
        parallax_px: Between near and far, over the whole rail.
        rng: Of the direction, masks and noise.
        shifted: Shift each sensor so that a plane between near and far stays put.
        noise: Standard deviation, full scales of one view.
    """
    near, far = scene.depth_range()
    focal_px = float(scene.intrinsics[0, 0])
    length = parallax_px / (focal_px * (1 / near - 1 / far))
    angle = rng.choice([0, 0.5, 1.0, 1.5]) * np.pi
    along = np.linspace(-0.5, 0.5, VIEWS)[:, None] * length * np.array([np.cos(angle), np.sin(angle), 0.0])
    along -= along[VIEWS // 2]
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, :3, 3] = -along
    seen = poses.copy()
    if shifted:
        still = rng.uniform(1 / far, 1 / near)
        # A sensor that is shifted sees what a sheared world would show it.
        seen[:, 0, 2], seen[:, 1, 2] = along[:, 0] * still, along[:, 1] * still
    views, _ = load_backend("cpu").views(
        scene.gaussians, torch.from_numpy(seen).float(), torch.from_numpy(scene.intrinsics).float(), scene.size
    )
    masks = random_masks(VIEWS, SIZE, 0.25, rng)
    truth = views.clamp(0, 1).numpy()
    coded = (masks[..., None] * truth).sum(axis=0) + noise * rng.standard_normal(truth.shape[1:])
    return Shot(
        measurement=coded.astype(np.float32),
        masks=masks,
        weights=np.ones(VIEWS, np.float32),
        intrinsics=scene.intrinsics,
        truth=Truth(truth, poses),
        name=scene.name,
    ).check()

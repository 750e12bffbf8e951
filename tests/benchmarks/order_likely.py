"""How often the order of depth that whole fits say is likelier is the wrong one, on drawn scenes.

    python -m tests.benchmarks order_likely

Measurements of 64 × 96 px: planes, rooms, thickets, balls, corridors, a box in a plain room, and things that move by
themselves; parallaxes of 1 to 8 px, fields of view of 20° to 60°. Tracks are not asked, so that each path gets whole
fits of both orders, and every second ten begins with the order of its tracks turned over. For each: what is said, and
whether that order is right. `GS2CI_COUNT` draws fewer or more than 40, `GS2CI_SEED` others.
"""

import os
from collections import Counter
from dataclasses import replace
from typing import Final

import numpy as np

from gs2ci.core.findings import Code
from gs2ci.core.records import Shot
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.geometry.reversal import turned as turned_geometry
from gs2ci.reconstruct.hypotheses import fitting, race
from gs2ci.reconstruct.hypotheses.hypothesis import DepthOrder, OrderFound
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.exposure import expose
from gs2ci_sims.light_path import sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import stage_move_for_parallax
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.files import LIBRARY, load_scene
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.scenes.stage import SuggestedCamera
from tests.processes import side_by_side
from tests.tables.order import depth_rank

SIZE: Final = (64, 96)
MASKS: Final = 8
SEED: Final = int(os.environ.get("GS2CI_SEED", "9100"))
COUNT: Final = int(os.environ.get("GS2CI_COUNT", "40"))
KINDS: Final = (
    "planes",
    "moving planes",
    "boxes",
    "blocks",
    "thicket",
    "moving boxes",
    "textureless",
    "ball",
    "corridor",
    "moving thicket",
)
_ORDER_OF: Final = fitting.Fits.order_of


def run() -> None:
    """Reconstruct all draws, print a row for each, and count."""
    counts: Counter[str] = Counter()
    for line, said in side_by_side(judge, range(COUNT)):
        counts[said] += 1
        print(line, flush=True)
    print(", ".join(f"{what}: {count}" for what, count in sorted(counts.items())))


def judge(number: int) -> tuple[str, str]:
    """Reconstruct a draw; return its row, and what is said of its order."""
    kind, parallax_px, shot, scene = draw(number)
    _turn_first_looks(turn=number // len(KINDS) % 2 == 1)
    settings = Settings(uncertainty=False)
    never_sure = replace(settings.geometry.criteria, order_errors=np.inf)
    found = reconstruct(shot, replace(settings, geometry=replace(settings.geometry, criteria=never_sure))).result
    said = "no depth"
    if found.depth is not None:
        right = depth_rank(found.depth[MASKS // 2], scene.depth) > 0
        likely = any(note.code is Code.DEPTH_ORDER_LIKELY for note in found.notes)
        said = f"{DepthOrder.LIKELY if likely else DepthOrder.OPEN}, {'right' if right else 'wrong'}"
    return f"{number:3} {kind:15} {parallax_px:4.1f} px  {said}", said


def _turn_first_looks(*, turn: bool) -> None:
    """Let no fit wait for a question of motion, and turn first looks over if asked."""

    def order_of(fits: fitting.Fits, first: FirstLook) -> tuple[FirstLook, OrderFound]:
        look, order = _ORDER_OF(fits, first)
        turns = turn and order.state == DepthOrder.OPEN
        return (replace(look, geometry=turned_geometry(look.geometry)) if turns else look), order

    fitting.Fits.order_of = order_of  # type: ignore[method-assign]
    race.Race._may_wait = lambda *_: False  # type: ignore[method-assign]


def draw(number: int) -> tuple[str, float, Shot, Scene]:
    """Return a draw's kind, its parallax in px, the measurement, and the scene with its true depth."""
    kind, rng = KINDS[number % len(KINDS)], np.random.default_rng([SEED, number])
    field_of_view_deg, parallax_px = float(rng.uniform(20, 60)), float(np.exp(rng.uniform(0, np.log(8))))
    scene = _scene(kind.split()[-1], field_of_view_deg, SEED + number, rng)
    rig = RigFigures(light=Light(float(rng.uniform(1500, 4180))), modulator=ModulatorFigures(masks=MASKS))
    angle = rng.uniform(0, 2 * np.pi)
    aim = (float(np.cos(angle)), float(np.sin(angle)), float(rng.uniform(-0.3, 0.3)))
    path = stage_move_for_parallax(scene, parallax_px, rig.exposure_s, direction=aim, wobble_deg=0.03)
    moves = (_thing(scene, rig.exposure_s, rng),) if kind.startswith("moving") else ()
    effects = (MotionBlur(), *sensor_effects(rig.sensor), *moves)
    masks = random_masks(MASKS, SIZE, 0.25, rng)
    return kind, parallax_px, expose(scene, path, masks, rig, effects=effects, seed=number), scene


def _scene(name: str, field_of_view_deg: float, seed: int, rng: np.random.Generator) -> Scene:
    if name == "planes":
        nearest = float(rng.uniform(1.5, 3.75))
        depths = tuple(np.sort(rng.uniform(nearest, 4.75, rng.integers(2, 6))).tolist())
        boxes = int(rng.integers(0, 3))
        return planes(rng, SIZE, depths=depths, backdrop=5.0, boxes=boxes, field_of_view_deg=field_of_view_deg)
    table = load_scene(name, size=SIZE).file.geometry
    return table.model_copy(update={"seed": seed}).build(SuggestedCamera(SIZE, field_of_view_deg), LIBRARY)


def _thing(scene: Scene, exposure_s: float, rng: np.random.Generator) -> ObjectMotion:
    """Return a ball of 8 to 18 px in the nearer half of the scene that moves by 2 to 24 px."""
    near, far = scene.depth_range()
    means = scene.gaussians.means.numpy()
    at = means[rng.choice(np.argsort(np.abs(means[:, 2] - rng.uniform(near, 0.5 * (near + far))))[:400])]
    px = float(at[2] / scene.intrinsics[0, 0])
    radius, speed = rng.uniform(8, 18) * px, float(np.exp(rng.uniform(np.log(2), np.log(24)))) * px / exposure_s
    angle = rng.uniform(0, 2 * np.pi)
    velocity = (speed * float(np.cos(angle)), speed * float(np.sin(angle)), 0.0)
    return ObjectMotion((float(at[0]), float(at[1]), float(at[2])), float(radius), velocity)

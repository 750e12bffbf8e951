"""Lengths on solids of known size: their errors, and whether their stated errors are correct.

    python -m tests.benchmarks lengths

A slanted panel, a ball and a staircase before a wall, as triangles that the simulator's ray caster shows, so that they
are no scene of the solver's own kind; 128 × 96 px, 8 masks, shot noise and readout noise, true masks, a camera matrix
without error, and a stage that tells the path exactly, in mm (`GS2CI_STAGE_OFF` makes each place err by a share
of the path). Default settings; `GS2CI_SEED` draws others, `GS2CI_SIZE` ("192x256") asks for another size, with the same
motion in mm. For each: random pairs of pixels on the solid, at least a quarter of its breadth apart, away from its rims
and of a confidence of 0.9 or more, as `gs2ci measure` measures them. Printed: the size, the median error of a length
between the pixels' middles, the share within 1 %, the scale that all lengths have in common, the median stated error,
and the share of lengths that lie within 1.96 of their stated standard errors, which ought to be 95 %: there the points
meant are anywhere within their pixels, as the stated error has it.
"""

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_erosion

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.records import Shot
from gs2ci.evaluate.measuring import measure
from gs2ci.evaluate.pages.run_evidence import read_run
from gs2ci.evaluate.run_folder import write_run
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.light_path import sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import stage_move_for_parallax
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.stage import SuggestedCamera
from tests.exposing import expose
from tests.processes import side_by_side
from tests.sims.scenes.solids import SOLIDS, solid
from tests.tables.cases import staged

HEIGHT, WIDTH = (int(side) for side in os.environ.get("GS2CI_SIZE", "96x128").split("x"))
VIEWS = 8
SEED = int(os.environ.get("GS2CI_SEED", "0"))
STAGE_OFF = float(os.environ.get("GS2CI_STAGE_OFF", "0"))
DRAWS = 2
PARALLAX_PX = 12.0 * WIDTH / 128
BACKDROP_MM = 600.0
PAIRS = 400
RIM_PX = 3
CONFIDENT = 0.9
COVERED = 1.96


@dataclass(frozen=True)
class Lengths:
    """Lengths between pairs of pixels.

    Args:
        true: Between the middles of pixels, [P], mm.
        meant: Between places anywhere within them, [P], mm.
        found: [P], mm.
        stated: Their standard errors, [P], mm.
    """

    true: F64
    meant: F64
    found: F64
    stated: F64

    def line(self) -> str:
        """Return what is printed of them."""
        off = np.abs(self.found / self.true - 1)
        covered = np.mean(np.abs(self.found - self.meant) <= COVERED * self.stated)
        scale = np.median(self.found / self.true)
        return (
            f"{len(off):4d} lengths, {100 * np.median(off):5.2f} % off, "
            f"{100 * np.mean(off <= 0.01):5.1f} % within 1 %, "
            f"scale {scale:.4f}, stated {100 * np.median(self.stated / self.true):5.2f} %, "
            f"{100 * covered:5.1f} % within 1.96 of it"
        )


def run() -> None:
    """Measure on every solid and print a line for it."""
    for line in side_by_side(judge, [(which, SEED + draw) for which in SOLIDS for draw in range(DRAWS)]):
        print(line, flush=True)


def judge(wanted: tuple[str, int]) -> str:
    """Reconstruct one solid and return its line."""
    which, seed = wanted
    shot, scene = take(which, seed)
    found = lengths(shot, scene, np.random.default_rng([seed, 2]))
    return f"{which:10} {seed:3d}  {HEIGHT} × {WIDTH} px  {found.line()}"


def take(which: str, seed: int) -> tuple[Shot, Scene]:
    """Expose a solid on the simulated bench, and let its stage tell the path."""
    rng = np.random.default_rng([seed, SOLIDS.index(which)])
    scene = solid(which, rng, SuggestedCamera((HEIGHT, WIDTH), 45.0), backdrop=BACKDROP_MM)
    rig = RigFigures(light=Light(4180.0), modulator=ModulatorFigures(VIEWS, 0.25))
    path = stage_move_for_parallax(scene, PARALLAX_PX, rig.exposure_s)
    masks = random_masks(VIEWS, (HEIGHT, WIDTH), 0.25, rng)
    shot = expose(scene, path, masks, rig, effects=(MotionBlur(), *sensor_effects(rig.sensor)), seed=seed)
    return staged(shot, STAGE_OFF, rng), scene


def lengths(shot: Shot, scene: Scene, rng: np.random.Generator) -> Lengths:
    """Reconstruct a shot, and measure random lengths on the solid in its middle view."""
    found = reconstruct(shot)
    view = shot.views // 2
    with tempfile.TemporaryDirectory() as folder:
        run_of = read_run(write_run(Path(folder) / "run", shot, found.result, found.scene))
        depth = true_depth(shot, scene, view)
        confidence = run_of.depth_confidence
        assert confidence is not None
        rows, columns = np.nonzero(on_solid(depth) & (confidence[view] >= CONFIDENT))
        apart = 0.25 * float(np.ptp(columns))
        true, meant, measured, stated = [], [], [], []
        for _ in range(PAIRS):
            one, other = rng.choice(len(rows), 2, replace=False)
            ends = [(int(columns[k]), int(rows[k])) for k in (one, other)]
            if np.hypot(*np.subtract(*ends)) < apart:
                continue
            length = measure(run_of, *ends, view)
            for wanted, within in ((true, np.full((2, 2), 0.5)), (meant, rng.random((2, 2)))):
                points = [
                    depth[row, column] * _ray(column + x, row + y, shot.intrinsics)
                    for (column, row), (x, y) in zip(ends, within, strict=True)
                ]
                wanted.append(float(np.linalg.norm(points[1] - points[0])))
            measured.append(length.length)
            stated.append(length.standard_error)
    return Lengths(np.array(true), np.array(meant), np.array(measured), np.array(stated))


def true_depth(shot: Shot, scene: Scene, view: int) -> F64:
    """Return the depth of a view, [H, W]."""
    assert shot.truth.depth is not None
    depth: F64 = np.asarray(shot.truth.depth[view], dtype=np.float64)
    return depth


def on_solid(depth: F64) -> Bool:
    """Tell which pixels show the solid, away from its rims, [H, W]."""
    inside: Bool = binary_erosion(depth < 0.97 * BACKDROP_MM, iterations=RIM_PX)
    return inside


def _ray(x: float, y: float, intrinsics: F64 | None) -> F64:
    assert intrinsics is not None
    return np.asarray(np.linalg.inv(intrinsics) @ [x, y, 1.0])

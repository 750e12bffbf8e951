"""The benches that plans are measured on: the rig files of the simulator, and some of them with other masks or a mesh.

`GS2CI_CASES` names some of them by parts of their labels, with commas between. For `simulation_cost` and
`plan_deviation`.
"""

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci_sims.effects.base import Effect
from gs2ci_sims.effects.stage import StageVibration
from gs2ci_sims.effects.views import Defocus, LensDistortion, OpticsPsf
from gs2ci_sims.exposure import integrate, read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.path import CameraPath
from gs2ci_sims.planner import plan
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.rigs import library
from gs2ci_sims.scene import Scene
from gs2ci_sims.simulation_plan import Plan, PlanChoice, SimulationTask
from tests.sims.adversaries import FAMILIES
from tests.sims.brute_force import BruteForce, deviation_dn, simulate_everything
from tests.sims.rig_files import read_rig_file

TOLERANCE_DN = 0.25
MESH_TOLERANCE_DN = 10.0
MESH = "blocks"
ADVERSARIAL = {
    "04_slow_stage": "complementary",
    "05_many_masks": "one-hot",
    "06_small_parallax": "complementary",
    "07_flickering_lamp": "stripes at Nyquist",
    "09_lcos": "aligned by turns",
    "11_moving_object": "all open",
}
WITH_MESH = ("02_good_dmd", "04_slow_stage", "06_small_parallax")
# Dear effects that are there but too small to matter: what leaving them out is worth.
IDLE: dict[str, tuple[Effect, ...]] = {
    "01_empty_bench": (Defocus(2e-5, 3.0), StageVibration(1e-7, 400.0), LensDistortion(1e-7), OpticsPsf(1e-3)),
    "02_good_dmd": (Defocus(2e-5, 3.0), StageVibration(1e-7, 400.0)),
    "04_slow_stage": (Defocus(2e-5, 3.0), StageVibration(1e-7, 400.0)),
    "05_many_masks": (Defocus(2e-5, 3.0), StageVibration(1e-7, 400.0)),
}


@dataclass(frozen=True)
class SimulationCase:
    """A rig file, with other masks, another scene or more effects than it says.

    Args:
        label: For the table.
        file: The rig file.
        family: Of masks (`tests.sims.adversaries`); None: as the file says.
        scene: Of the simulator's library; None: as the file says.
        idle: Effects in addition to the file's.
    """

    label: str
    file: Path
    family: str | None = None
    scene: str | None = None
    idle: tuple[Effect, ...] = ()

    @property
    def tolerance_dn(self) -> float:
        """Get what a plan is asked for: sharp edges between few rays are grainy."""
        return TOLERANCE_DN if self.scene is None else MESH_TOLERANCE_DN

    def bench(self, seed: int, size: tuple[int, ...] | None = None) -> "SimulationBench":
        """Build it.

        Args:
            seed: Of masks and all draws.
            size: Of the pictures, if not as the file says, px.
        """
        setup = dataclasses.replace(read_rig_file(self.file), seed=seed)
        if size is not None:
            height, width = size
            setup = dataclasses.replace(setup, scene=dataclasses.replace(setup.scene, height=height, width=width))
        if self.scene is not None:
            setup = dataclasses.replace(setup, scene=dataclasses.replace(setup.scene, name=self.scene, seed=None))
        scene, rig = setup.scene.build(), setup.rig
        added = {effect.name for effect in self.idle}
        effects = (*(effect for effect in setup.effects if effect.name not in added), *self.idle)
        path = setup.path.build(scene, rig.exposure_s)
        if self.family is None:
            masks = setup.masks()
        else:
            ends_s = rig.timing.intervals_s(rig.modulator.masks)[-1:, 1]
            image = Renderer().views(scene, path.world_to_camera(ends_s))[0][0].mean(axis=2).astype(np.float64)
            masks = FAMILIES[self.family](rig.modulator.masks, image, np.random.default_rng(seed))
        return SimulationBench(scene, path, masks, rig, effects, seed, self.tolerance_dn)


@dataclass(frozen=True)
class SimulationBench:
    """A case, built: what is seen, from where, behind which masks, with which effects."""

    scene: Scene
    path: CameraPath
    masks: F32
    rig: RigFigures
    effects: tuple[Effect, ...]
    seed: int
    tolerance_dn: float

    def simulate(self, effects: tuple[Effect, ...], renderer: Renderer) -> F64:
        """Expose and read out with these effects; return the mean photons in each pixel, [H, W, 3]."""
        chain = EffectChain(effects, self.seed, self.rig)
        photons = integrate(self.scene, self.path, self.masks, chain, renderer=renderer)
        read_out(photons, chain)
        return photons

    def planned(self) -> tuple[Plan, F64]:
        """Plan within the tolerance and simulate so; the renderer remembers nothing from before."""
        task = SimulationTask(self.scene, self.path, self.masks, self.rig, self.effects, self.seed)
        decided = plan(task, PlanChoice(self.tolerance_dn), renderer=Renderer())
        return decided, self.simulate(decided.effects, decided.renderer)

    def everything(self, settle_dn: float) -> BruteForce:
        """Simulate everything, with twice as many views until the readings change by no more than this."""
        args: tuple[Any, ...] = (self.scene, self.path, self.masks, self.rig, self.effects)
        return simulate_everything(*args, seed=self.seed, settle_dn=settle_dn, renderer=Renderer())

    def off_dn(self, settled: BruteForce, photons: F64, decided: Plan) -> float:
        """Return by how much a plan's readings differ from those of everything, DN rms."""
        return deviation_dn(settled, photons, decided.effects, self.seed)


def simulation_cases(*, meshes: tuple[str, ...] = WITH_MESH, idle: bool = True) -> list[SimulationCase]:
    """List the cases that `GS2CI_CASES` asks for, or all.

    Args:
        meshes: Which rigs also look at a mesh.
        idle: Whether some rigs come once more with effects that are too small to matter.
    """
    cases: list[SimulationCase] = []
    for file in library():
        name = file.stem.replace("_", " ")
        cases.append(SimulationCase(name, file))
        if file.stem in ADVERSARIAL:
            family = ADVERSARIAL[file.stem]
            cases.append(SimulationCase(f"{name}, {family}", file, family=family))
        if file.stem in meshes:
            cases.append(SimulationCase(f"{name}, a mesh, {MESH_TOLERANCE_DN:g} DN", file, scene=MESH))
        if idle and file.stem in IDLE:
            cases.append(SimulationCase(f"{name}, {len(IDLE[file.stem])} idle", file, idle=IDLE[file.stem]))
    wanted = os.environ.get("GS2CI_CASES", "").split(",")
    return [case for case in cases if any(part in case.label for part in wanted)]

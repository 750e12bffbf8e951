"""What a plan costs and gains: against everything at its own tolerance, and against all effects with its own sampling.

Rigs are those of `sims/gs2ci_sims/rigs`, six of them once more with masks that cancel or align, one that looks at a
mesh, and four with dear effects added that are there but too small to matter ("idle"). Per rig, three simulations are
timed in one process, each the best of several: the plan (planning and preview included), (a) everything (views doubled
until the readings change by less than the tolerance; all rounds, and the last one by its share of the views), and (b)
all effects of the rig with the moments that the plan chose, which nobody had to plan. Times are the processor's, all
threads together; the last columns are times over the plan's. "Off" is the largest over three draws
(`GS2CI_DRAWS`) of the rms difference to a simulation of everything that has settled to a fifth of the tolerance.
"""

import dataclasses
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gs2ci_sims.brute_force import deviation_dn, simulate_everything
from gs2ci_sims.effects.base import Effect
from gs2ci_sims.effects.defocus import Defocus
from gs2ci_sims.effects.lens_distortion import LensDistortion
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.optics_psf import OpticsPsf
from gs2ci_sims.effects.stage_vibration import StageVibration
from gs2ci_sims.exposure import integrate, read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.planner import plan
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig_file import Setup, read_rig_file
from gs2ci_sims.rigs import library
from tests.sims.adversaries import FAMILIES

TOLERANCE_DN = 0.25
MESH_TOLERANCE_DN = 10.0
SETTLED = 0.2
DRAWS = int(os.environ.get("GS2CI_DRAWS", "3"))
ADVERSARIAL = {
    "04_slow_stage": "complementary",
    "05_many_masks": "one-hot",
    "06_small_parallax": "complementary",
    "07_flickering_lamp": "stripes at Nyquist",
    "09_lcos": "aligned by turns",
    "11_moving_object": "all open",
}
# Dear effects that are there but too small to matter: what leaving them out is worth.
IDLE: dict[str, tuple[Effect, ...]] = {
    "01_empty_bench": (Defocus(2e-5, 3.0), StageVibration(1e-7, 400.0), LensDistortion(1e-7), OpticsPsf(1e-3)),
    "02_good_dmd": (Defocus(2e-5, 3.0), StageVibration(1e-7, 400.0)),
    "04_slow_stage": (Defocus(2e-5, 3.0), StageVibration(1e-7, 400.0)),
    "05_many_masks": (Defocus(2e-5, 3.0), StageVibration(1e-7, 400.0)),
}


def _best(function: Callable[[], Any], repeat_s: float = 1.0) -> tuple[float, Any]:
    """Return the least time of the processor, over all threads, that a call takes: others' work does not count."""
    seconds: list[float] = []
    while len(seconds) < 3 and sum(seconds) < repeat_s:
        began_s = time.process_time()
        result = function()
        seconds.append(time.process_time() - began_s)
    return min(seconds), result


def _masks(setup: Setup, scene: Any, path: Any, family: str | None, seed: int) -> Any:
    if family is None:
        return setup.masks()
    ends_s = setup.rig.timing.intervals_s(setup.rig.modulator.masks)[-1:, 1]
    image = Renderer().views(scene, path.world_to_camera(ends_s))[0][0].mean(axis=2).astype(np.float64)
    return FAMILIES[family](setup.rig.modulator.masks, image, np.random.default_rng(seed))


def _row(label: str, file: Path, family: str | None, scene_name: str | None, idle: tuple[Effect, ...] = ()) -> None:
    tolerance_dn = TOLERANCE_DN if scene_name is None else MESH_TOLERANCE_DN
    off = 0.0
    for seed in range(DRAWS):
        setup = dataclasses.replace(read_rig_file(file), seed=seed)
        if scene_name is not None:
            setup = dataclasses.replace(setup, scene=dataclasses.replace(setup.scene, name=scene_name, seed=None))
        scene, rig = setup.scene.build(), setup.rig
        added = {effect.name for effect in idle}
        effects = (*(effect for effect in setup.effects if effect.name not in added), *idle)
        path = setup.path.build(scene, rig.exposure_s)
        masks = _masks(setup, scene, path, family, seed)

        def simulate(
            chosen: tuple[Any, ...], renderer: Renderer, seed: int = seed, args: Any = (scene, path, masks, rig)
        ) -> Any:
            chain = EffectChain(chosen, seed, args[3])
            photons = integrate(*args[:3], chain, renderer=renderer).photons
            read_out(photons, chain)
            return photons

        def planned(
            seed: int = seed, args: Any = (scene, path, masks, rig), effects: Any = effects, simulate: Any = simulate
        ) -> Any:
            decided = plan(*args, effects, tolerance_dn=tolerance_dn, seed=seed, renderer=Renderer())
            return decided, simulate(decided.effects, decided.renderer)

        settled = simulate_everything(
            scene, path, masks, rig, effects, seed=seed, settle_dn=SETTLED * tolerance_dn, renderer=Renderer()
        )
        if seed == 0:
            planned()  # compiles
            plan_s, (decided, photons) = _best(planned)
            began_s = time.process_time()
            same = simulate_everything(
                scene, path, masks, rig, effects, seed=seed, settle_dn=tolerance_dn, renderer=Renderer()
            )
            rounds_s = time.process_time() - began_s
            # Rounds have 1, 2, 4, ... parts per mask.
            last_s = rounds_s * same.parts / (2 * same.parts - 1)
            blur = [effect for effect in decided.effects if isinstance(effect, MotionBlur)]
            everything = (*(effect for effect in effects if not isinstance(effect, MotionBlur)), *blur)
            all_s, _ = _best(lambda chosen=everything, simulate=simulate: simulate(chosen, Renderer()))
            figures = (decided, plan_s, same.views, last_s, rounds_s, all_s)
        else:
            decided, photons = planned()
        off = max(off, deviation_dn(settled, photons, decided.effects, seed))
    decided, plan_s, same_views, last_s, rounds_s, all_s = figures
    simulated = sum(decision.simulated for decision in decided.decisions)
    print(
        f"| {label} | {simulated} of {len(decided.decisions)} | {decided.views} | {off:.3f} | {decided.error_dn:.3f} "
        f"| {plan_s:.2f} | {same_views} | {last_s:.2f} | {last_s / plan_s:.1f}x | {rounds_s / plan_s:.1f}x "
        f"| {all_s / plan_s:.2f}x |",
        flush=True,
    )


def run() -> None:
    """Print a table, a row per case; `GS2CI_CASES` names some of them by a part of their names."""
    wanted = os.environ.get("GS2CI_CASES", "").split(",")
    rows: list[tuple[str, Path, str | None, str | None, tuple[Effect, ...]]] = []
    for file in library():
        name = file.stem.replace("_", " ")
        rows.append((name, file, None, None, ()))
        if file.stem in ADVERSARIAL:
            rows.append((f"{name}, {ADVERSARIAL[file.stem]}", file, ADVERSARIAL[file.stem], None, ()))
        if file.stem == "04_slow_stage":
            rows.append((f"{name}, a mesh, {MESH_TOLERANCE_DN:g} DN", file, None, "blocks", ()))
        if file.stem in IDLE:
            rows.append((f"{name}, {len(IDLE[file.stem])} idle", file, None, None, IDLE[file.stem]))
    print("| case | effects | views | off by, DN | bound, DN | plan, s | views (a) | (a), s | (a) | (a), all | (b) |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for row in rows:
        if any(part in row[0] for part in wanted):
            _row(*row)

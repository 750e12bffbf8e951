"""Masks that cancel in sum or align with the scene: what is left out is still within the tolerance."""

import numpy as np
import pytest

from gs2ci_sims.effects.masks import MaskEdges
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.exposure import integrate, read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.path import stage_move_for_parallax
from gs2ci_sims.planner import plan
from gs2ci_sims.preview import preview
from gs2ci_sims.rig import ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.simulation_plan import PlanChoice, SimulationTask
from tests.sims.adversaries import FAMILIES
from tests.sims.brute_force import deviation_dn, simulate_everything

SIZE, MASKS = (32, 44), 8


@pytest.fixture(scope="module")
def scene():
    return planes(np.random.default_rng(12), SIZE)


def bench(scene, family, parallax_px, masks=MASKS):
    rig = RigFigures(modulator=ModulatorFigures(masks=masks), timing=Timing(0.02))
    path = stage_move_for_parallax(scene, parallax_px + 1e-9, rig.exposure_s, wobble_deg=0.0)
    image = preview(scene, path, np.ones((masks, *SIZE), np.float32), rig).views[-1].mean(axis=2)
    return rig, path, FAMILIES[family](masks, image, np.random.default_rng(3))


def test_complementary_masks_do_not_hide_what_their_edges_change(scene):
    """Pairs m, 1 - m add up to 1 whatever blurs them, but each pair's masks see the moving scene from two places."""
    rig, path, masks = bench(scene, "complementary", 12.0)
    effect = MaskEdges(0.5)

    def readings(effects):
        chain = EffectChain(effects, 0, rig)
        return read_out(integrate(scene, path, masks, chain), chain)

    change = readings((MotionBlur(5), effect)) - readings((MotionBlur(5),))
    truth_dn = np.sqrt(np.square(change).mean())
    assert truth_dn > 10
    assert effect.bound(preview(scene, path, masks, rig), rig).rms_dn >= truth_dn
    decided = plan(SimulationTask(scene, path, masks, rig, (MotionBlur(), effect)))
    assert "mask_edges" in {kept.name for kept in decided.effects}


@pytest.mark.parametrize("family", FAMILIES)
def test_a_plan_stays_within_its_tolerance_for_every_family_of_masks(scene, family):
    rig, path, masks = bench(scene, family, 1.0, masks=4)
    effects = (MotionBlur(), MaskEdges(0.05))
    everything = simulate_everything(scene, path, masks, rig, effects, seed=0)
    for tolerance_dn in (0.25, 5.0):
        decided = plan(SimulationTask(scene, path, masks, rig, effects), PlanChoice(tolerance_dn))
        photons = integrate(scene, path, masks, EffectChain(decided.effects, 0, rig))
        assert decided.error_dn <= tolerance_dn
        assert deviation_dn(everything, photons, decided.effects, 0) <= decided.error_dn + 0.01

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.masks import Misregistration
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.exposure import integrate
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.path import ReversingMove, StageMove
from gs2ci_sims.planner import plan
from gs2ci_sims.rig_file import setup_from_tables
from gs2ci_sims.sensor import SensorFigures
from gs2ci_sims.simulation_plan import SimulationTask
from tests.sims.rig_files import read_rig_file


def read(tmp_path, text):
    file = tmp_path / "rig.toml"
    file.write_text(text, encoding="utf-8")
    return read_rig_file(file)


def test_an_empty_file_is_a_rig_of_defaults_with_what_every_sensor_does(tmp_path):
    setup = read(tmp_path, "")
    assert [effect.name for effect in setup.effects] == [
        "motion_blur", "shot_noise", "full_well", "read_noise", "quantisation"
    ]  # fmt: skip
    assert setup.plan.tolerance_dn == 0.25
    assert setup.masks().shape == (8, 96, 128)


def test_tables_become_records_and_integers_and_arrays_what_the_records_want(tmp_path):
    setup = read(
        tmp_path,
        """
        seed = 7
        device_seed = 3
        [light]
        full_scale_photons = 100
        [modulator]
        masks = 3
        [sensor]
        bits = 10
        [effects.misregistration]
        right_px = 1
        [effects.object_motion]
        centre = [0, 0, 2.5]
        radius = 0.5
        velocity = [1.0, 0.0, 0.0]
        [plan]
        tolerance_dn = 1
        on = ["misregistration"]
        """,
    )
    assert setup.seed == 7
    assert setup.rig.device_seed == 3
    assert setup.rig.light.full_scale_photons == 100.0
    assert Misregistration(right_px=1.0) in setup.effects
    assert ObjectMotion((0.0, 0.0, 2.5), 0.5, (1.0, 0.0, 0.0)) in setup.effects
    assert setup.plan.on == ("misregistration",)
    assert next(effect for effect in setup.effects if effect.name == "quantisation").bits == 10


def test_an_effect_of_the_file_replaces_what_the_sensor_implies(tmp_path):
    setup = read(tmp_path, "[effects.read_noise]\nsigma_e = 9.0")
    assert [effect.sigma_e for effect in setup.effects if effect.name == "read_noise"] == [9.0]


def test_bounds_count_charge_up_to_the_full_well_that_the_file_gives_as_an_effect(tmp_path):
    setup = read(tmp_path, "[light]\nfull_scale_photons = 6e4\n[modulator]\nmasks = 4\nopen_share = 1.0\n"
                           "[path]\nparallax_px = 0.0\n[scene]\nheight = 24\nwidth = 32\n"
                           "[effects.full_well]\ncapacity_e = 2e5\n")  # fmt: skip
    assert setup.rig.sensor.full_well_e == 2e5
    scene = setup.scene.build()
    path = setup.path.build(scene, setup.rig.exposure_s)
    decided = plan(SimulationTask(scene, path, setup.masks(), setup.rig, setup.effects))
    bound = next(one.bound for one in decided.decisions if one.name == "shot_noise")
    photons = integrate(scene, path, setup.masks(), EffectChain(setup.effects, 0, setup.rig))
    charge = setup.rig.sensor.quantum_efficiency * photons
    assert charge.mean() > 4 * SensorFigures().full_well_e
    assert bound.rms_dn >= setup.rig.dn_per_e * np.sqrt(charge.mean())


def test_the_same_file_gives_the_same_masks_scene_and_path(tmp_path):
    text = "[scene]\nheight = 12\nwidth = 16\nseed = 3\n[path]\nparallax_px = 2.0"
    first, second = read(tmp_path, text), read(tmp_path, text)
    assert np.array_equal(first.masks(), second.masks())
    scene = first.scene.build()
    assert np.array_equal(scene.gaussians.means, second.scene.build().gaussians.means)
    assert first.path.build(scene, 1.0) == second.path.build(scene, 1.0)


def test_a_stage_turns_back_as_often_as_the_file_says(tmp_path):
    setup = read(tmp_path, "[scene]\nheight = 12\nwidth = 16\n[path]\nparallax_px = 2.0\nturns = 2")
    path = setup.path.build(setup.scene.build(), 1.0)
    assert isinstance(path, ReversingMove)
    right = -path.world_to_camera(np.linspace(-0.5, 0.5, 1001))[:, 0, 3]
    assert np.count_nonzero(np.diff(np.sign(np.diff(right)))) == 2


def test_a_stage_at_rest_is_one(tmp_path):
    setup = read(tmp_path, "[scene]\nheight = 12\nwidth = 16\n[path]\nparallax_px = 0")
    path = setup.path.build(setup.scene.build(), 1.0)
    assert isinstance(path, StageMove)
    assert path.velocity == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[lihgt]", "unknown key 'lihgt' in the top of the file; did you mean 'light'"),
        ("[effects.defocsu]", "unknown key 'defocsu' in \\[effects\\]; did you mean 'defocus'"),
        ("[effects.prnu]\nspraed = 1.0", "unknown key 'spraed' in \\[effects.prnu\\]; did you mean 'spread'"),
        ("[effects.defocus]\naperture = 1.0", r"key 'focus_depth' is missing in \[effects.defocus\]"),
        ("[effects]\ndefocus = 3", r"'defocus' in \[effects\] is 3: it should be a table"),
        ("[light]\nfull_scale_photons = 'many'", "is 'many': it should be a number$"),
        ("[modulator]\nmasks = true", r"'masks' in \[modulator\] is True: it should be a whole number"),
        ("[modulator]\nmasks = 0", "masks = 0 in ModulatorFigures"),
        ("[effects.bayer_filter]\npattern = 'XYZW'", "is 'XYZW'"),
        ("[path]\ndirection = [1.0]", r"in \[path.direction\]|'direction' in \[path\]"),
        ("[path]\nturns = -1", "turns"),
        ("[path]\nturns = 2\nwobble_deg = 0.1", "2 turns and a wobble of 0.1 deg"),
        ("a = " + 5000 * "[", "nests too deep"),
        ("[scene]\nname = 'corridor'\nseed = 1", "for the scene 'planes' alone"),
        ("device_seed = -1", "device_seed = -1"),
        ("light", "is not TOML"),
    ],
)
def test_what_a_rig_file_may_not_say_is_refused_by_name(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read(tmp_path, text)


def test_a_scene_that_is_not_there_is_refused_when_it_is_built(tmp_path):
    with pytest.raises(InputError, match="corridoor"):
        read(tmp_path, "[scene]\nname = 'corridoor'").scene.build()


def test_a_file_in_another_encoding_is_refused(tmp_path):
    file = tmp_path / "rig.toml"
    file.write_bytes("# Größe\n".encode("latin-1"))
    with pytest.raises(InputError, match="not text in UTF-8"):
        read_rig_file(file)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_rig_file(tmp_path / "none.toml")


def test_keys_without_any_near_one_are_refused_too():
    with pytest.raises(InputError, match="unknown key"):
        setup_from_tables({"zzz": 1})

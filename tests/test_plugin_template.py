"""The template package of docs/plugin-template, installed by its metadata, and each of its parts used."""

import os
import subprocess
import sys
import tomllib
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from gs2ci.api.decoders import Choice, decoder_of
from gs2ci.api.plugins import built_in_names
from gs2ci.core.config import ConfigTable
from gs2ci.core.errors import InputError
from gs2ci.core.plugins import PluginError, installed
from gs2ci.core.progress import Silent
from gs2ci.core.storage import read_shot
from gs2ci.reconstruct.fit.rules import with_rule
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.paper.priors2d.choose import load_prior
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.named import PRESETS
from gs2ci.rig.opening import load_rig
from gs2ci_drivers import plugin as driver_plugins
from gs2ci_sims import light_path as light_paths
from gs2ci_sims.light_path import LIGHT_PATH, EffectChain, light_path
from gs2ci_sims.rig_file import effects_from_tables
from gs2ci_sims.scenes.files import load_scene

TEMPLATE = Path(__file__).parents[1] / "docs" / "plugin-template"
RIG = """
[modulator]
kind = "lamp-array"

[sensor]
kind = "v4l2"
port = "simulated"

[capture]
masks = 4
mask_s = 0.005

[registration]
superpixel = 1

[world]
scene = "planes"
height = 12
width = 16
[world.effects.dim_corner]
share = 0.5
"""


@pytest.fixture
def template(tmp_path, monkeypatch):
    """Install the template: its sources and the metadata that pip would write of its pyproject.toml."""
    project = tomllib.loads((TEMPLATE / "pyproject.toml").read_text())["project"]
    information = tmp_path / "site" / "gs2ci_lamp_array-0.1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    lines = [
        line
        for group, entries in project["entry-points"].items()
        for line in (f"[{group}]", *(f"{name} = {value}" for name, value in entries.items()))
    ]
    (information / "entry_points.txt").write_text("\n".join(lines) + "\n")
    for folder in (TEMPLATE / "src", tmp_path / "site"):
        monkeypatch.syspath_prepend(folder)
    return project["entry-points"]


def test_every_part_is_listed_and_none_is_broken(template):
    found = {(one.group, one.name) for one in installed(built_in_names()) if one.package == "gs2ci-lamp-array"}
    assert found == {(group, name) for group, entries in template.items() for name in entries}
    assert [one.problem for one in installed(built_in_names()) if one.package == "gs2ci-lamp-array"] == [""] * len(
        found
    )


def test_the_driver_opens_by_its_kind_and_a_capture_runs_through_its_twin(template, tmp_path, gs2ci):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG)
    assert gs2ci("capture", "--rig", rig, "-o", tmp_path / "shot.h5") == 0
    shot = read_shot(tmp_path / "shot.h5")
    assert shot.masks.shape == (4, 12, 16)
    assert shot.measurement.max() > 0


def test_settings_of_the_driver_are_checked_as_ours_are(template, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.replace('kind = "lamp-array"', 'kind = "lamp-array"\nbaut = 9600'))
    with pytest.raises(InputError, match=r"unknown key 'baut' in \[modulator\]; did you mean 'baud'\?"):
        load_rig(rig)


def test_a_kind_that_nobody_brings_is_refused_as_before(tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG)
    with pytest.raises(InputError, match=r"unknown kind 'lamp-array' in \[modulator\]; allowed"):
        load_rig(rig)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (7, "is int"),
        (driver_plugins.DriverPlugin(ConfigTable, None, None), "do not fit it"),
    ],
)
def test_what_is_no_driver_is_refused(monkeypatch, wrong, said):
    monkeypatch.setattr(driver_plugins, "load", lambda *_: wrong)
    with pytest.raises(PluginError, match=said):
        driver_plugins.driver_plugin("gs2ci.modulators", "odd")


def test_a_driver_without_a_twin_cannot_be_simulated(template, tmp_path, monkeypatch):
    bare = replace(import_module("gs2ci_lamp_array.plugin").LAMP_ARRAY, twin=None)
    monkeypatch.setattr(driver_plugins, "load", lambda _, kind: bare)
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG)
    with pytest.raises(InputError, match="'lamp-array' has no twin"):
        load_rig(rig)


def test_the_density_rule_is_taken_by_name(template, random_shot):
    fit = with_rule(PRESETS["draft"].fit, "still")
    assert fit.density.name == "still"
    settings = replace(PRESETS["draft"], fit=replace(fit, iterations=2), fits=1)
    assert reconstruct(random_shot, settings).result.views.shape == (6, 16, 20, 3)


def test_a_rule_under_another_name_than_its_own_is_refused(monkeypatch, template):
    still = import_module("gs2ci_lamp_array.density").STILL
    monkeypatch.setattr("gs2ci.reconstruct.fit.rules.load", lambda *_: still)
    with pytest.raises(PluginError, match="'other' is not a density rule"):
        with_rule(PRESETS["draft"].fit, "other")


def test_the_decoder_is_taken_by_name_and_its_views_are_checked(template, random_shot, monkeypatch):
    decode = decoder_of(Choice("mean", None, None, None, 0))
    views, method, _ = decode(random_shot, Silent())
    light = random_shot.masks.sum(axis=0) * 0.5
    lit = light > 0
    np.testing.assert_allclose(views[3][lit], (random_shot.measurement / np.maximum(light, 1e-6)[..., None])[lit], 1e-5)
    assert method == {"name": "mean"}
    monkeypatch.setattr("gs2ci.api.decoders.load", lambda *_: lambda shot, progress: np.zeros((2, 3)))
    with pytest.raises(PluginError, match=r"returned \[2, 3\]"):
        decoder_of(Choice("mean", None, None, None, 0))(random_shot, Silent())


def test_a_decoder_that_nobody_brings_is_refused():
    with pytest.raises(InputError, match=r"no method 'magic'; allowed: gap-tv, .*amdi"):
        decoder_of(Choice("magic", None, None, None, 0))


def test_prior_and_geometry_are_taken_by_name(template):
    assert load_prior("median", 0).name == "median"
    assert load_geometry_prior("sideways").name == "sideways"


def test_the_effect_stands_in_its_stage_and_darkens_its_corner(template):
    (effect,) = effects_from_tables({"dim_corner": {"share": 0.25}})
    kinds = light_path(["dim_corner"])
    assert light_path([]) == LIGHT_PATH
    assert [kind for kind in kinds if kind in LIGHT_PATH] == list(LIGHT_PATH)
    assert effect.stage is kinds[kinds.index(type(effect)) - 1].stage
    assert EffectChain([effect], 0).effects == (effect,)


def test_what_is_no_effect_is_refused(template, monkeypatch):
    light_paths._plugged.cache_clear()
    monkeypatch.setattr(light_paths, "load", lambda *_: 7)
    with pytest.raises(PluginError, match="'dim_corner' is no effect: it has no stage, no cost_ns"):
        effects_from_tables({"dim_corner": {}})


def test_a_broken_effect_that_nobody_asks_for_is_nobodys_trouble(template, monkeypatch):
    brought = light_paths.load
    light_paths._plugged.cache_clear()
    monkeypatch.setattr(light_paths, "names", lambda _: ["broken", "dim_corner"])
    monkeypatch.setattr(light_paths, "load", lambda group, name: 7 if name == "broken" else brought(group, name))
    (effect,) = effects_from_tables({"dim_corner": {"share": 0.25}})
    assert effect.name == "dim_corner"
    with pytest.raises(PluginError, match="'broken' is no effect"):
        effects_from_tables({"broken": {}})
    with pytest.raises(InputError, match="dim_cornr"):
        effects_from_tables({"dim_cornr": {}})
    light_paths._plugged.cache_clear()


def test_an_effect_cannot_take_the_name_of_ours(template, monkeypatch):
    class Twice(light_paths.ShotNoise):
        name = "shot_noise"

    light_paths._plugged.cache_clear()
    monkeypatch.setattr(light_paths, "names", lambda _: ["shot_noise"])
    monkeypatch.setattr(light_paths, "load", lambda *_: Twice)
    with pytest.raises(PluginError, match="has the name of an effect of gs2ci"):
        light_path(["shot_noise"])
    light_paths._plugged.cache_clear()


def test_the_scene_is_loaded_by_name(template):
    assert load_scene("two-boxes", size=(24, 32)).views == 4


def test_the_templates_own_tests_pass(template, tmp_path):
    path = os.pathsep.join([str(tmp_path / "site"), str(TEMPLATE / "src"), *filter(None, sys.path)])
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, "--rootdir", "."]
    done = subprocess.run(
        [*command, str(TEMPLATE / "tests")],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]
    assert " passed" in done.stdout

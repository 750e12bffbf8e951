import numpy as np
import pytest

from gs2ci.api.demonstration import check_demo_place, demo_rig, write_rig
from gs2ci.api.rigs import open_rig
from gs2ci.commands import capture
from gs2ci.commands.demo import run
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.storage import read_shot
from gs2ci_sims.sensor import SensorFigures


@pytest.fixture(scope="module")
def shot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    rig = write_rig(folder / "rig.toml", views=4, size=(68, 100), parallax_px=3.0, seed=0)
    return read_shot(capture.run(rig=rig, out=folder / "shot.h5"))


def test_the_demonstrations_exposure_is_complete_and_uses_the_wells_range(shot):
    assert shot.measurement.shape == (68, 100, 1)
    assert shot.cfa == "RGGB"
    assert shot.masks.mean() == pytest.approx(0.25, abs=0.02)
    assert shot.truth.views.shape == (4, 68, 100, 3)
    assert shot.saturated.mean() < 0.01
    assert shot.measurement.max() > 1.0


def test_the_demonstration_has_realistic_noise_and_blur(shot):
    coded = (shot.weights[:, None, None, None] * shot.masks[..., None] * shot.truth.views).sum(axis=0)
    mosaic = np.empty(shot.size)
    for channel, (row, column) in zip((0, 1, 1, 2), ((0, 0), (0, 1), (1, 0), (1, 1)), strict=True):
        mosaic[row::2, column::2] = coded[row::2, column::2, channel]
    error = (shot.measurement[..., 0] - mosaic)[~shot.saturated].std()
    assert 0.005 < error < 0.1


def test_near_and_far_move_against_each_other_as_asked(shot):
    centres = np.linalg.inv(shot.truth.world_to_camera)[:, :3, 3]
    steps = np.diff(centres, axis=0)
    np.testing.assert_allclose(steps, np.tile(steps[0], (3, 1)), atol=1e-6)
    assert np.linalg.norm(centres[-1] - centres[0]) > 0.01


def test_nothing_tells_the_solver_how_the_stage_carries_the_camera(shot):
    assert shot.telemetry_world_to_camera is None


@pytest.mark.parametrize("views", [8, 9, 12, 40])
def test_a_white_scene_fits_the_sensors_well_under_any_number_of_masks(tmp_path, views):
    with open_rig(demo_rig(tmp_path / "rig.toml", views=views, height=16, width=16)) as rig:
        (bright,) = [one for one in rig.plan().plan.figures if one.what == "bright pixels of a white scene"]
    assert not bright.broken
    assert float(bright.value.split()[0]) > 0.75 * SensorFigures().full_well_e


def test_no_parallax_at_all_is_a_rig_too(tmp_path, capsys):
    rig = write_rig(tmp_path / "rig.toml", views=2, size=(68, 100), parallax_px=0.0, seed=0)
    plan, count = capture.take(rig, tmp_path / "shot.h5")
    assert (plan.settings.shots, count) == (1, 1)
    assert "next:" not in capsys.readouterr().out, "the demonstration reconstructs by itself"
    shot = read_shot(tmp_path / "shot.h5")
    centres = np.linalg.inv(shot.truth.world_to_camera)[:, :3, 3]
    assert np.ptp(centres, axis=0).max() < 1e-6


def test_a_file_where_the_folder_should_be_is_a_clear_error(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StorageError, match="file is not a folder"):
        run(tmp_path / "file", views=2, height=68, width=100)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    "wish",
    [
        {"views": 0}, {"views": 5000}, {"height": 69}, {"width": 102}, {"height": 0}, {"height": 542}, {"width": 964},
        {"parallax_px": -1.0}, {"parallax_px": float("nan")}, {"seed": -1},
    ],
    ids=str,
)  # fmt: skip
def test_what_no_demonstration_can_be_is_refused_by_its_option(tmp_path, wish):
    ((name, value),) = wish.items()
    with pytest.raises(InputError, match=f"--{name.replace('_', '-')} {value:g}; allowed: a .* what to do: "):
        run(tmp_path / "demo", **wish)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["rig.toml", "shot.h5", "shot.h5.partial", "run/report.json"])
def test_what_no_demonstration_made_is_not_replaced_by_one(tmp_path, name):
    mine = tmp_path / name
    mine.parent.mkdir(exist_ok=True)
    mine.write_text('{"schema": "gs2ci.report/2"}')
    with pytest.raises(StorageError, match="is not replaced"):
        run(tmp_path, views=2, height=16, width=16)
    assert mine.read_text() == '{"schema": "gs2ci.report/2"}'
    assert [path.name for path in tmp_path.iterdir()] == [name.partition("/")[0]]


def test_a_rig_file_of_ones_own_is_not_replaced_by_that_of_a_demonstration_which_its_own_is(tmp_path):
    own, made = tmp_path / "own.toml", tmp_path / "demo.toml"
    own.write_text('name = "mine"')
    with pytest.raises(StorageError, match="is not replaced"):
        demo_rig(own)
    assert own.read_text() == 'name = "mine"'
    for seed in (1, 2):
        assert f"seed = {seed}" in demo_rig(made, views=2, height=16, width=16, seed=seed).read_text()
    check_demo_place(tmp_path / "nothing yet")

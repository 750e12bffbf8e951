import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.rig.config import rig_from_tables
from gs2ci.rig.design.exposing import full_size, middles, small_bench
from tests.small_benches import SIZE, TABLES, bench_of


def test_an_exposure_is_what_its_masks_code_of_the_true_views(tmp_path):
    bench = bench_of(tmp_path, world={"noise": False, "devices": "ideal"})
    shot = bench.expose(bench.table.capture)
    coded = (shot.masks[..., None] * shot.truth.views).sum(axis=0)
    assert np.sqrt(np.mean((shot.measurement - coded) ** 2)) < 0.03
    assert shot.telemetry_world_to_camera is not None
    assert not shot.saturated.any()


def test_each_exposure_has_masks_and_noise_of_its_own(tmp_path):
    bench = bench_of(tmp_path)
    first, again, other = (bench.expose(bench.table.capture, index) for index in (0, 0, 1))
    assert np.array_equal(first.measurement, again.measurement)
    assert not np.array_equal(first.masks, other.masks)
    assert np.array_equal(bench.masks(bench.table.capture, 1), other.masks)


def test_more_light_saturates_and_less_is_noisier(tmp_path):
    bright = bench_of(tmp_path, optics={"full_scale_e_per_s": 1e7})
    assert bright.expose(bright.table.capture).saturated.mean() > 0.2
    dim = bench_of(tmp_path, optics={"full_scale_e_per_s": 1e3})
    shot = dim.expose(dim.table.capture)
    coded = (shot.masks[..., None] * shot.truth.views).sum(axis=0)
    assert np.sqrt(np.mean((shot.measurement - coded) ** 2)) > 0.1


def test_the_scene_moves_through_the_small_picture_by_the_share_that_the_bench_moves_its_own(tmp_path):
    shares = []
    for scene, size in (("planes", SIZE), ("boxes", SIZE), ("boxes", (72, 96))):
        bench = bench_of(tmp_path, scene, size, world={"scene_units_per_mm": 0.05})
        near, far = bench.scene.depth_range()
        moved = -bench.poses(bench.table.capture, np.array([0.0, 1.0]))[:, 0, 3]
        shares.append(np.ptp(moved) * bench.scene.intrinsics[0, 0] / size[1] * (1 / near - 1 / far))
    assert shares == pytest.approx([shares[0]] * 3, rel=1e-6)


def test_distances_and_focal_length_of_the_optics_decide_if_they_are_stated(tmp_path):
    optics = {"focal_px": 100.0, "nearest_mm": 100.0, "farthest_mm": 200.0}
    bench = bench_of(tmp_path, optics=optics)
    near, far = bench.scene.depth_range()
    moved = -bench.poses(bench.table.capture, np.array([0.0, 1.0]))[:, 0, 3]
    assert np.ptp(moved) * bench.scene.intrinsics[0, 0] * (1 / near - 1 / far) == pytest.approx(2 * 100 * 0.005)


def real(tables):
    return {key: {**table, "port": "/dev/null"} if "kind" in table else table for key, table in tables.items()}


def test_a_real_bench_must_state_its_light_and_distances(tmp_path):
    tables = real({key: table for key, table in TABLES.items() if key != "world"})
    with pytest.raises(InputError, match="the light of 'rig' is not known"):
        small_bench(rig_from_tables(tables, tmp_path / "rig.toml"), "boxes", SIZE)
    tables["optics"] = {"full_scale_e_per_s": 1e5}
    with pytest.raises(InputError, match="the distances of 'rig' are not known"):
        small_bench(rig_from_tables(tables, tmp_path / "rig.toml"), "boxes", SIZE)
    tables["optics"] |= {"focal_px": 800.0, "nearest_mm": 300.0}
    bench = small_bench(rig_from_tables(tables, tmp_path / "rig.toml"), "boxes", SIZE)
    assert bench.expose(bench.table.capture).size == SIZE
    del tables["sensor"]["height"]
    with pytest.raises(InputError, match="the size of the picture of 'rig' is not known"):
        full_size(rig_from_tables(tables, tmp_path / "rig.toml"))


def test_an_unknown_scene_is_refused(tmp_path):
    with pytest.raises(InputError, match="no scene 'boxen'; did you mean 'boxes'"):
        bench_of(tmp_path, "boxen")


def test_a_camera_at_rest_has_one_pose(tmp_path):
    bench = bench_of(tmp_path, capture={"axis": ""})
    poses = bench.poses(bench.table.capture, middles(3))
    assert np.array_equal(poses, np.repeat(bench.scene.world_to_camera[None], 3, axis=0))
    assert bench.expose(bench.table.capture).telemetry_world_to_camera is None

"""What files tell of a scene seen from beside its path, and how a run is scored by it."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.settings import Settings
from tests.benchmarks.beside_files import write_light_field, write_planes
from tests.tables import works
from tests.tables.beside import PLACES, BesideViews, beside_file, beside_path, depth_beside, read_beside, scores_beside
from tests.tables.case_sets import file_cases
from tests.tables.cases import Case
from tests.tables.catalogue import TABLES, TableOptions
from tests.tables.columns import AGAINST_PAPER
from tests.tables.works import COUNTED_AFTER, reconstruct_case

SIZE = (24, 32)


@pytest.fixture(scope="module")
def planes(tmp_path_factory):
    return write_planes(tmp_path_factory.mktemp("files"), 0, SIZE)


def test_a_file_that_tells_is_no_case_of_its_own_and_its_case_depends_on_it(planes):
    (case,) = file_cases(planes.parent)
    assert case.name == "planes_0"
    assert case.files == (str(planes), str(beside_file(str(planes))))
    entries = TABLES["paper"].entries(TableOptions((case,), seeds=1, lines=("default",)))
    assert entries[0].cell.files == case.files
    assert Case("boxes", scene="boxes").files == ()


def test_a_name_with_a_point_keeps_it(tmp_path):
    assert beside_file(str(tmp_path / "a.b.npz")) == tmp_path / "a.b.beside.npz"


def test_photographs_on_planes_tell_what_lies_between_and_beyond(planes):
    case = Case("planes", file=str(planes))
    shot, told = case.shot(0), case.novel_views(case.shot(0))
    assert told.views.shape == (2, *SIZE, 3)
    seen = shot.truth.views
    off = [float(np.mean((told.views[0] - view) ** 2)) for view in seen]
    assert sorted(np.argsort(off)[:2]) == [3, 4]  # of eight
    off = [float(np.mean((told.views[1] - view) ** 2)) for view in seen]
    assert np.argmin(off) == 7
    assert told.depth.shape == SIZE
    assert 1 < told.depth[told.depth > 0].min() < told.depth.max() < 4


def test_the_middle_of_a_file_is_cut_from_both_alike(planes):
    whole, cut = (Case("planes", file=str(planes), size=size) for size in (None, (16, 20)))
    shot, told, all_told = cut.shot(0), cut.novel_views(cut.shot(0)), whole.novel_views(whole.shot(0))
    assert np.array_equal(told.views, all_told.views[:, 4:20, 6:26])
    assert np.array_equal(told.depth, all_told.depth[4:20, 6:26])
    assert np.array_equal(shot.truth.views, whole.shot(0).truth.views[:, 4:20, 6:26])


def test_of_another_path_and_of_a_file_alone_nobody_knows(planes, tmp_path):
    thinned = Case("planes", file=str(planes), views=4)
    assert thinned.novel_views(thinned.shot(0)) is None
    (tmp_path / "alone.npz").write_bytes(planes.read_bytes())
    alone = Case("alone", file=str(tmp_path / "alone.npz"))
    assert alone.files == (alone.file,)
    assert alone.novel_views(alone.shot(0)) is None


@pytest.mark.parametrize(
    ("arrays", "why"),
    [
        ({"image": np.zeros((1, 4, 4, 3))}, "tells no views"),
        ({"views": np.zeros((3, 4, 4, 3))}, r"views \[3, 4, 4, 3\]"),
        ({"views": np.full((1, 4, 4, 3), np.nan)}, "holds views"),
        ({"views": np.zeros((1, 0, 4, 3))}, r"views \[1, 0, 4, 3\]"),
        ({"views": np.zeros((1, 4, 4, 3)), "depth": np.zeros((4, 5))}, r"depth \[4, 5\]"),
    ],
)
def test_a_file_that_tells_nothing_of_use_is_refused(tmp_path, arrays, why):
    file = tmp_path / "a.npz"
    np.savez(beside_file(str(file)), **arrays)
    with pytest.raises(InputError, match=why) as caught:
        read_beside(str(file), None)
    assert "between, beyond" in caught.value.allowed


@pytest.mark.parametrize("white", [np.uint8(255), np.uint16(65535), np.float32(1), np.float64(1)])
def test_views_are_scaled_by_the_white_of_their_type(tmp_path, white):
    views = np.zeros((2, 4, 4, 3), white.dtype)
    views[1] = white
    np.savez(beside_file(str(tmp_path / "a.npz")), views=views)
    told = read_beside(str(tmp_path / "a.npz"), None)
    assert told.views.dtype == np.float32
    assert (np.unique(told.views[0]), np.unique(told.views[1])) == (0, 1)


@pytest.mark.parametrize("value", [np.float32(255), np.float32(-0.6), np.int16(255), np.uint32(65535)])
def test_views_of_another_scale_are_refused(tmp_path, value):
    np.savez(beside_file(str(tmp_path / "a.npz")), views=np.full((1, 4, 4, 3), value))
    with pytest.raises(InputError, match="holds views from") as caught:
        read_beside(str(tmp_path / "a.npz"), None)
    assert "full scale 1" in caught.value.allowed
    assert "white" in caught.value.remedy


def test_each_place_has_its_score_and_none_where_nobody_knows():
    rng = np.random.default_rng(0)
    views = (0.8 * rng.random((2, 8, 8, 3))).astype(np.float32)
    images = views + np.array([0.1, 0.01], np.float32)[:, None, None, None]
    assert scores_beside(images, BesideViews(views)) == pytest.approx(
        {"between_psnr_db": 20, "beyond_psnr_db": 40}, 1e-3
    )
    one = scores_beside(images, BesideViews(views[:1]))
    assert one["between_psnr_db"] == pytest.approx(20, 1e-3)
    assert one["beyond_psnr_db"] is None
    assert set(scores_beside(images, None).values()) == {None}
    grey = BesideViews(views.mean(axis=3, keepdims=True))
    assert scores_beside(images, grey)["between_psnr_db"] == pytest.approx(20, 1e-3)


def test_depth_from_between_is_scored_up_to_its_unit(planes):
    case = Case("planes", file=str(planes))
    shot = case.shot(0)
    told = case.novel_views(shot)
    exact = depth_beside(7 * told.depth, told, shot, shot.intrinsics)
    assert exact.median_rel == pytest.approx(0, abs=1e-6)
    assert exact.median_px == pytest.approx(0, abs=1e-4)
    inverted = depth_beside(np.where(told.depth > 0, 1 / np.maximum(told.depth, 1e-3), 0), told, shot, shot.intrinsics)
    assert inverted.rank == pytest.approx(-1)
    assert depth_beside(told.depth, replace(told, depth=None), shot, shot.intrinsics) is None


def test_a_file_is_scored_beside_its_path_and_its_population_counted(planes, monkeypatch):
    def brief(_variant, seed):
        settings = Settings(seed=seed, fits=1, poses="tracks", look_again=False, motion="off")
        return replace(settings, fit=replace(settings.fit, iterations=8))

    monkeypatch.setattr(works, "settings_of", brief)
    row = reconstruct_case(asdict(Case("planes", file=str(planes))), "default", 0)
    assert {measure.key for measure in AGAINST_PAPER} <= row.keys()
    assert all(5 < row[f"{place}_psnr_db"] < 60 for place in PLACES)
    assert 0 <= row["depth_rel_percent"] < 100
    assert -1 <= row["depth_rank"] <= 1
    assert row["iterations"] == 8
    assert row["population"][-1] == (8, row["gaussians"])
    assert row["gaussians_most"] == max(count for _, count in row["population"])
    assert [row[f"gaussians_after_{iteration}"] for iteration in COUNTED_AFTER] == [None] * 3
    assert row["processor_seconds"] > 0


def test_the_light_field_is_coded_without_the_pictures_that_judge_it(tmp_path):
    """Nine pictures along a rail, of which the file codes all but the fifth: each is recognised by its brightness."""
    rng = np.random.default_rng(0)
    truth = np.broadcast_to(np.array([10, 20, 30, 40, 60, 70, 80, 90])[:, None, None, None], (8, *SIZE, 3))
    poses = np.tile(np.eye(4), (8, 1, 1))
    poses[:, 0, 3] = [0, -1, -2, -3, -5, -6, -7, -8]
    masks = (rng.random((8, *SIZE)) < 0.25).astype(np.uint8)
    np.savez(tmp_path / "antinous.npz", truth=truth.astype(np.uint8), masks=masks, world_to_camera=poses, K=np.eye(3))
    between, disparity = np.full((*SIZE, 3), 50, np.uint8), np.full(SIZE, 2, np.float32)
    disparity[0] = 0
    np.savez(tmp_path / "antinous_between.npz", view=between, disparity=disparity)
    file = write_light_field(tmp_path, tmp_path)
    with np.load(file) as made:
        assert np.unique(made["truth"]).tolist() == [20, 30, 40, 60, 70, 80]
        assert made["world_to_camera"][:, 0, 3].tolist() == [-1, -2, -3, -5, -6, -7]
        coded = (made["masks"][..., None] * (made["truth"] / 255)).sum(axis=0)
        assert np.allclose(made["meas"], coded, atol=1e-5)
    told = read_beside(str(file), None)
    assert [round(255 * float(view.mean())) for view in told.views] == [50, 90]
    assert np.unique(told.depth).tolist() == [0, 0.5]


def wandering(count):
    """Cameras near the origin that look along z, and never along one line."""
    rng = np.random.default_rng(0)
    found = np.tile(np.eye(4), (count, 1, 1))
    found[:, :3, :3] = Rotation.from_rotvec(0.1 * rng.standard_normal((count, 3))).as_matrix()
    found[:, :3, 3] = 0.3 * rng.standard_normal((count, 3))
    return found


def test_places_beside_a_rail_are_half_a_step_and_a_step_away():
    rail = np.tile(np.eye(4), (6, 1, 1))
    rail[:, 0, 3] = np.arange(6)
    found = beside_path(rail)
    np.testing.assert_allclose(found[:, 0, 3], [2.5, 6.0], atol=1e-12)
    found[:, 0, 3] = 0
    np.testing.assert_allclose(found, rail[:1].repeat(2, axis=0), atol=1e-12)


def test_places_beside_a_path_move_with_it():
    true_path = wandering(5)
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), [0.4, -1.0, 0.2]
    np.testing.assert_allclose(beside_path(true_path @ world), beside_path(true_path) @ world, atol=1e-9)
    longer = true_path.copy()
    longer[:, :3, 3] *= 2.5
    expected = beside_path(true_path)
    expected[:, :3, 3] *= 2.5
    np.testing.assert_allclose(beside_path(longer), expected, atol=1e-9)


def test_a_single_pose_has_no_place_beside_it():
    with pytest.raises(InputError, match="a path of 1"):
        beside_path(np.eye(4)[None])

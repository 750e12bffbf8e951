import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.render.ply import write_ply
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.scenes.files import load_scene, scene_names

SIZE = (36, 54)


@pytest.fixture
def write(tmp_path):
    def written(text):
        path = tmp_path / "scene.toml"
        path.write_text(text)
        return path

    return written


def test_the_library_holds_a_scene_of_every_kind():
    assert scene_names() == (
        "ball",
        "blocks",
        "boxes",
        "corridor",
        "glossy",
        "motorcycle",
        "moving",
        "planes",
        "textureless",
        "thicket",
    )


@pytest.mark.parametrize("name", [name for name in scene_names() if name != "motorcycle"])
def test_every_scene_of_the_library_can_be_seen_along_its_path(name):
    loaded = load_scene(name, size=SIZE, parallax_px=2.0)
    assert loaded.scene.name == name
    assert loaded.scene.size == SIZE
    assert loaded.views == 8
    assert loaded.light.full_scale_photons > 0
    poses = loaded.path(0.8).world_to_camera(np.array([-0.4, 0.4]))
    assert not np.allclose(poses[0], poses[1])
    radiance, coverage = Renderer().views(loaded.scene, poses)
    assert np.abs(radiance[0] - radiance[1]).mean() > 1e-3
    assert coverage.min() > 0.97


def test_the_photograph_keeps_its_own_lens():
    loaded = load_scene("motorcycle", size=(34, 50))
    assert loaded.scene.size == (34, 50)
    with pytest.raises(InputError, match="photograph's own"):
        load_scene("motorcycle", size=(34, 50), field_of_view_deg=40.0)


def test_size_field_of_view_views_and_motion_can_be_chosen():
    loaded = load_scene("planes", size=SIZE, field_of_view_deg=90.0, views=16, parallax_px=3.0)
    assert loaded.scene.intrinsics[0, 0] == pytest.approx(0.5 * SIZE[1])
    assert loaded.views == 16
    near, far = loaded.scene.depth_range()
    poses = loaded.path(2.0).world_to_camera(np.array([-1.0, 1.0]))
    centres = [-(pose[:3, :3].T @ pose[:3, 3]) for pose in poses]
    move = np.hypot(*(centres[1] - centres[0])[:2])
    assert loaded.scene.intrinsics[0, 0] * move * (1 / near - 1 / far) == pytest.approx(3.0, rel=1e-3)


def test_a_path_given_as_travel_covers_it_in_the_exposure_whatever_its_length():
    loaded = load_scene("corridor", size=SIZE)
    for exposure_s in (0.01, 5.0):
        poses = loaded.path(exposure_s).world_to_camera(np.array([-0.5, 0.5]) * exposure_s)
        centres = [-(pose[:3, :3].T @ pose[:3, 3]) for pose in poses]
        np.testing.assert_allclose(centres[1] - centres[0], [0.03, 0.0, 0.12], atol=1e-9)


def test_parallax_that_is_chosen_replaces_the_travel_of_the_file():
    still = load_scene("corridor", size=SIZE, parallax_px=0.0).path(1.0)
    assert still.velocity == pytest.approx((0.0, 0.0, 0.0))


def test_only_the_moving_scene_has_an_object_in_motion():
    moving = load_scene("moving", size=SIZE).object_motion(0.5)
    assert isinstance(moving, ObjectMotion)
    assert moving.velocity == pytest.approx((0.3, 0.1, 0.0))
    assert load_scene("planes", size=SIZE).object_motion(0.5) is None


def test_a_scene_file_may_name_a_ply_file_beside_it(write, small_scene, tmp_path):
    write_ply(tmp_path / "stand.ply", small_scene.gaussians)
    loaded = load_scene(write('name = "stand"\n[geometry]\nkind = "ply"\nfile = "stand.ply"\n'), size=SIZE)
    assert loaded.scene.name == "stand"
    assert len(loaded.scene.gaussians) == len(small_scene.gaussians)


def test_a_ply_scene_may_be_seen_from_a_pose(write, small_scene, tmp_path):
    write_ply(tmp_path / "stand.ply", small_scene.gaussians)
    rows = "[[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]]"
    text = f'name = "s"\n[geometry]\nkind = "ply"\nfile = "stand.ply"\nworld_to_camera = {rows}\n'
    scene = load_scene(write(text), size=SIZE).scene
    assert scene.world_to_camera[2, 3] == 1.0
    assert scene.median_depth == pytest.approx(small_scene.median_depth + 1, rel=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            'name = "a"\n[geometry]\nkind = "boxes"\ncuont = 3\n',
            r"unknown key 'cuont' in \[geometry\]; did you mean 'count'",
        ),
        ('name = "a"\n[geometry]\nkind = "boxes"\n[camera]\nheigth = 3\n', "did you mean 'height'"),
        ('name = "a"\n[geometry]\nkind = "boxes"\n[lihgt]\n', "did you mean 'light'"),
        ('name = "a"\n[geometry]\nkind = "spheres"\n', "unknown kind 'spheres' in "),
        ('name = "a"\n[geometry]\nkind = "boxes"\n[light]\nfull_scale_photons = -1.0\n', "full_scale_photons"),
        ('name = "a"\n[geometry]\nkind = "boxes"\n[path]\nviews = 8\n', "one of parallax_px and travel"),
        ("name = \n", "is not TOML"),
        ('[geometry]\nkind = "boxes"\n', "'name' is missing"),
    ],
)  # fmt: skip
def test_a_file_that_does_not_fit_is_refused_and_the_nearest_key_named(write, text, message):
    with pytest.raises(InputError, match=message):
        load_scene(write(text), size=SIZE)


def test_a_scene_that_is_not_in_the_library_is_refused_with_the_nearest_one():
    with pytest.raises(InputError, match="no scene 'corider'; did you mean 'corridor'"):
        load_scene("corider")


@pytest.mark.parametrize(
    "options", [{"size": (0, 5)}, {"views": 0}, {"parallax_px": -1.0}, {"field_of_view_deg": 190.0}]
)
def test_figures_given_instead_of_the_files_are_checked_too(options):
    with pytest.raises(InputError, match=r"greater than|less than"):
        load_scene("planes", **options)


@pytest.mark.parametrize("name", ["corridor", "moving"])
def test_an_exposure_without_length_has_no_path(name):
    with pytest.raises(InputError, match=r"exposure|duration"):
        load_scene(name, size=SIZE).path(0.0)


def test_an_exposure_without_length_moves_no_object():
    with pytest.raises(InputError, match="exposure of 0"):
        load_scene("moving", size=SIZE).object_motion(0.0)

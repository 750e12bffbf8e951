import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.radiance import Renderer, rendered_depth
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.scenes.rectangles import texture


def draw(seed=0, **options):
    return planes(np.random.default_rng(seed), (48, 64), **options)


def test_the_same_generator_draws_the_same_scene_and_another_seed_another():
    first, again, other = (draw(seed).gaussians for seed in (1, 1, 2))
    for name, tensor in first.parameters().items():
        assert np.array_equal(tensor, again.parameters()[name]), name
    assert not np.array_equal(first.means[:50], other.means[:50]) or not np.array_equal(
        first.colours[:50], other.colours[:50]
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_true_depth_is_that_of_the_rendered_surfaces(seed):
    scene = draw(seed, boxes=2)
    rendered = rendered_depth(scene.gaussians, np.eye(4), scene.intrinsics, scene.size)
    error = np.abs(rendered - scene.depth) / scene.depth
    assert np.median(error) < 0.003
    assert np.mean(error > 0.05) < 0.12


def test_the_backdrop_fills_the_frame_and_everything_stands_before_it():
    scene = draw(backdrop=6.0)
    assert np.nanmax(scene.depth) == pytest.approx(6.0)
    assert np.isfinite(scene.depth).all()
    assert np.nanmin(scene.depth) < 3.0
    _, coverage = Renderer().views(scene, np.eye(4)[None])
    assert coverage.min() > 0.98


def test_a_scene_may_be_a_backdrop_alone():
    scene = draw(depths=(), boxes=0)
    assert scene.depth == pytest.approx(np.full(scene.size, 5.0))


@pytest.mark.parametrize("slope", [0.0, 1.0, 2.0])
def test_textures_have_power_at_every_frequency_with_the_slope_asked_for(slope):
    image = texture(np.random.default_rng(0), (256, 256), slope)[..., 0]
    power = np.abs(np.fft.rfft2(image - image.mean())) ** 2
    frequency = np.hypot(np.fft.fftfreq(256)[:, None], np.fft.rfftfreq(256)[None, :])
    bands = [(0.02, 0.04), (0.2, 0.4)]
    low, high = (power[(frequency >= a) & (frequency < b)].mean() for a, b in bands)
    assert high > 0
    assert np.log10(low / high) == pytest.approx(2 * slope, abs=0.35)
    assert 0 <= image.min() <= image.max() <= 1


@pytest.mark.parametrize("options", [{"depths": (0.0,)}, {"depths": (5.5,)}, {"depths": (), "backdrop": -1.0}])
def test_rectangles_behind_the_camera_or_the_backdrop_are_refused(options):
    with pytest.raises(InputError, match="backdrop"):
        draw(**options)

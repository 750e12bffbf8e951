"""Depth is where half of the stopped light has been stopped: by hand, and by the kernel beside the definition."""

import math
from dataclasses import replace

import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render.conventions import ALPHA_MAX
from gs2ci.render.gaussians import Gaussians, joined
from gs2ci.render.stopping import NEARBY, RATIO_MAX, depth_fields
from tests.render.backends import BACKENDS, load_backend, to_the_end
from tests.render.reference import project

SIZE = (9, 11)
MIDDLE = (0, 4, 5)
INTRINSICS = torch.tensor([[20.0, 0, 5.5], [0, 20.0, 4.5], [0, 0, 1]])
POSE = torch.eye(4)[None]


def sheet(depth=4.0, logit=8.0, scales=(3.0, 3.0, 1e-4), turn_deg=0.0, x=0.0):
    """A flat Gaussian across the axis, turned about the vertical."""
    half = math.radians(turn_deg) / 2
    return Gaussians(
        means=torch.tensor([[x, 0.0, depth]]),
        log_scales=torch.tensor([scales]).log(),
        quaternions=torch.tensor([[math.cos(half), 0, math.sin(half), 0]]),
        opacity_logits=torch.tensor([logit]),
        colours=torch.tensor([[0.2, 0.5, 0.9]]),
    )


def logit(alpha):
    return math.log(alpha / (1 - alpha))


@pytest.mark.parametrize("name", BACKENDS)
def test_one_surface_is_where_it_is_and_sure(name):
    found = load_backend(name).depths(sheet(), POSE, INTRINSICS, SIZE)
    assert found.depth[MIDDLE].item() == pytest.approx(4.0, rel=1e-5)
    assert found.spread[MIDDLE].item() == pytest.approx(0, abs=1e-4)
    assert found.stopped[MIDDLE].item() == pytest.approx(ALPHA_MAX, abs=1e-6)
    assert found.nearby[MIDDLE].item() == pytest.approx(found.stopped[MIDDLE].item(), abs=1e-6)


@pytest.mark.parametrize("name", BACKENDS)
def test_a_slanted_sheet_is_a_plane_along_every_ray(name):
    turn = math.radians(50)
    found = load_backend(name).depths(sheet(scales=(1.5, 1.5, 1e-4), turn_deg=50), POSE, INTRINSICS, SIZE)
    # The sheet's points are (s cos, 0, 4 - s sin): a ray of slope u meets it at z = 4 / (1 + u tan).
    slopes = (torch.arange(SIZE[1]) + 0.5 - 5.5) / 20
    there = found.stopped[0, 4] > 0.05
    expected = 4 / (1 + slopes * math.tan(turn))
    assert int(there.sum()) > 5
    # The pixel's own width, which blurs the sheet's, flattens the slope by 1.3 %.
    torch.testing.assert_close(found.depth[0, 4][there].double(), expected[there].double(), rtol=1e-2, atol=0)


@pytest.mark.parametrize("name", BACKENDS)
def test_between_two_surfaces_depth_is_one_of_them_and_never_their_mean(name):
    backend = load_backend(name)
    for alpha, depth in ((0.6, 2.0), (0.4, 6.0)):
        scene = joined([sheet(2.0, logit(alpha)), sheet(6.0, 8.0)])
        found = backend.depths(scene, POSE, INTRINSICS, SIZE)
        assert found.depth[MIDDLE].item() == pytest.approx(depth, rel=1e-4)
        assert found.nearby[MIDDLE].item() < 0.7
        assert found.spread[MIDDLE].item() > 0.1


@pytest.mark.parametrize("name", BACKENDS)
def test_at_a_tie_the_nearer_surface_has_it(name):
    # The first stops a third, the second half of the rest: equal shares.
    scene = joined([sheet(2.0, logit(1 / 3)), sheet(6.0, logit(1 / 2))])
    found = load_backend(name).depths(scene, POSE, INTRINSICS, SIZE)
    # Its far side, within which a whole half of all light has been stopped.
    assert found.depth[MIDDLE].item() == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("name", BACKENDS)
def test_where_nothing_is_stopped_all_maps_are_zero(name):
    backend = load_backend(name)
    empty = sheet().map(lambda t: t[:0])
    for scene in (empty, sheet(depth=-3.0), sheet(logit=-20.0), sheet(scales=(0.01, 0.01, 0.01), x=40.0)):
        found = backend.depths(scene, POSE, INTRINSICS, SIZE)
        for values in (found.depth, found.spread, found.stopped, found.nearby):
            assert values.shape == (1, *SIZE)
            assert not values.any()


@pytest.mark.parametrize("name", BACKENDS)
def test_a_thick_gaussian_spreads_its_light(name):
    found = load_backend(name).depths(sheet(scales=(3.0, 3.0, 0.4)), POSE, INTRINSICS, SIZE)
    assert found.depth[MIDDLE].item() == pytest.approx(4.0, rel=1e-4)
    # 68 % of a parabola of this variance lie within 1.10 standard deviations: 1.5 t - 0.5 t^3 = 0.68 at t = 0.493.
    near, far = 4 - 0.493 * math.sqrt(5) * 0.4, 4 + 0.493 * math.sqrt(5) * 0.4
    assert found.spread[MIDDLE].item() == pytest.approx((4 / near - 4 / far) / 2, rel=0.005)
    along = NEARBY * 4 / (0.4 * math.sqrt(5))
    assert found.nearby[MIDDLE].item() == pytest.approx(1.5 * along - 0.5 * along**3, rel=0.01)


@pytest.mark.parametrize("name", BACKENDS)
def test_numbers_stay_finite_and_in_front_for_needles_sheets_seen_edge_on_and_giants(name):
    backend = load_backend(name)
    for scales, turn in (((5.0, 1e-5, 1e-5), 89.9), ((50.0, 50.0, 1e-6), 89.99), ((90.0, 90.0, 90.0), 30.0)):
        found = backend.depths(sheet(scales=scales, turn_deg=turn), POSE, INTRINSICS, SIZE)
        for values in (found.depth, found.spread, found.stopped, found.nearby):
            assert torch.isfinite(values).all()
        assert found.depth.min() >= 0
        assert found.depth.max() <= 2 * RATIO_MAX * 4


@pytest.mark.parametrize("seed", range(4))
def test_the_kernel_agrees_with_the_definition(seed, make, with_margin, fast):
    case = with_margin(lambda start: make(1000 * seed + start, size=(13, 18)), whole_views=True)
    definition = load_backend("reference").depths(case.scene, case.poses, case.intrinsics, case.size)
    found = to_the_end(fast).depths(case.scene, case.poses, case.intrinsics, case.size)
    torch.testing.assert_close(found.stopped.double(), definition.stopped, rtol=1e-4, atol=1e-5)
    # Between two surfaces the share is level, and a rounding decides which of them has it.
    near = (found.depth - definition.depth).abs() <= 1e-4 * definition.depth
    assert near.double().mean() > 0.995
    assert ((found.nearby - definition.nearby).abs()[near] < 1e-3).double().mean() > 0.99
    assert ((found.spread - definition.spread).abs()[near] < 1e-3).double().mean() > 0.99


@pytest.mark.parametrize(("count", "logit"), [(300, -3.0), (2000, -4.5)])
def test_in_fog_the_kernel_agrees_with_the_definition(count, logit, fast):
    # A pixel's light is stopped by a hundred thick and faint Gaussians, whose sums are the kernel's in float32; or by
    # so many that those which cannot hold the depth are sorted out on the way.
    draw = torch.Generator().manual_seed(5)
    fog = Gaussians(
        means=torch.randn(count, 3, generator=draw) * torch.tensor([0.5, 0.5, 0.8]) + torch.tensor([0.0, 0.0, 4.0]),
        log_scales=-0.5 + 0.3 * torch.randn(count, 3, generator=draw),
        quaternions=torch.randn(count, 4, generator=draw),
        opacity_logits=logit + 0.5 * torch.randn(count, generator=draw),
        colours=torch.rand(count, 3, generator=draw),
    )
    definition = load_backend("reference").depths(fog, POSE, INTRINSICS, SIZE)
    found = to_the_end(fast).depths(fog, POSE, INTRINSICS, SIZE)
    assert definition.stopped.min() > 0.5
    for name in ("depth", "spread", "stopped", "nearby"):
        torch.testing.assert_close(getattr(found, name).double(), getattr(definition, name), rtol=2e-4, atol=2e-5)


@pytest.mark.parametrize("name", BACKENDS)
def test_a_size_without_pixels_is_refused(name):
    with pytest.raises(InputError, match="image size"):
        load_backend(name).depths(sheet(), POSE, INTRINSICS, (0, 5))


@pytest.mark.parametrize("moving", [False, True])
def test_what_each_gaussian_says_of_depth_is_what_the_definition_says(moving, make):
    case = make(2)
    scene = case.scene.map(lambda t: t.detach())
    quaternions = scene.quaternions.clone()
    quaternions[0] = 0.0  # turns nothing
    scene = replace(scene, quaternions=quaternions)
    moved = torch.linspace(0, 0.1, len(case.poses))[:, None, None] + scene.means
    means = moved if moving else scene.means
    given = (scene.log_scales, scene.quaternions, case.poses, case.intrinsics)
    for view, found in enumerate(depth_fields(means, *given, case.size)):
        then = replace(scene, means=moved[view]) if moving else scene
        exact = then.map(lambda t: t.double())
        splats = project(exact, case.poses[view].double(), case.intrinsics.double(), case.size, exact.colours)
        told = torch.cat([splats.depths[:, None], splats.depth_slopes / splats.depths[:, None]], dim=1)
        ours = found[splats.index].double()
        torch.testing.assert_close(ours[:, :3], told, rtol=1e-5, atol=1e-7)
        # Of flat Gaussians a difference of nearly equal numbers is left.
        torch.testing.assert_close(ours[:, 3], splats.depth_sigmas, rtol=1e-4, atol=1e-5)

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.fit.optimiser.poses import PoseCorrections, PoseSettings, length_of
from gs2ci.reconstruct.fit.scene.rigid import RigidMotions
from gs2ci.reconstruct.geometry.path.telemetry import PoseErrors
from tests.render import se3

VIEWS = 3


@pytest.fixture
def path():
    twists = torch.randn(VIEWS, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    return se3.exp(0.1 * twists).numpy()


def push(poses, gradient):
    """Add a gradient by the poses' own twists, [N, 6], as a rendering would."""
    pull(poses, lambda moved: (se3.log(moved @ se3.inverse(poses.world_to_camera())) * gradient).sum())


def pull(poses, objective):
    """Add the gradient of an objective of the poses."""
    moved = poses.world_to_camera().clone().requires_grad_()
    objective(moved).backward()
    poses.pull(poses.world_to_camera(), moved.grad.numpy())


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.3, 0.4999, 0.5001, 2.0, 3.1])
def test_corrections_and_their_gradient_are_those_of_the_exponential(path, angle):
    draw = torch.Generator().manual_seed(3)
    twists = torch.randn(VIEWS, 6, dtype=torch.float64, generator=draw)
    twists[:, 3:] *= angle / twists[:, 3:].norm(dim=1, keepdim=True)
    weights = torch.randn(VIEWS, 4, 4, dtype=torch.float64, generator=draw)
    weights[:, 3] = 0
    exact = twists.clone().requires_grad_()
    expected = se3.exp(exact) @ torch.from_numpy(path)
    (expected * weights).sum().backward()
    motions = RigidMotions(twists.numpy())
    found = motions.matrices @ path
    np.testing.assert_allclose(found, expected.detach(), rtol=1e-12, atol=1e-12)
    gradient = motions.by_twists(found, weights.numpy())
    np.testing.assert_allclose(gradient, exact.grad, rtol=1e-10, atol=1e-10)


def test_gradients_by_twists_are_in_their_units_and_add_up(path):
    poses = PoseCorrections(path, PoseSettings(unit="path cube"))
    length = length_of("path cube", path)
    for _ in range(2):
        push(poses, torch.ones(VIEWS, 6))
    expected = np.tile([2 * length] * 3 + [2.0] * 3, (VIEWS, 1))
    np.testing.assert_allclose(poses.state().gradient, expected, rtol=1e-5)


def test_poses_start_at_their_estimates(path):
    poses = PoseCorrections(path, PoseSettings())
    np.testing.assert_allclose(poses.world_to_camera().detach().numpy(), path, atol=1e-6)


def test_without_refinement_the_poses_stay_exactly_as_they_were(path):
    poses = PoseCorrections(path, PoseSettings(refine=False))
    push(poses, torch.ones(VIEWS, 6))
    for i in range(10):
        poses.step(i / 10)
    poses.restore(poses.snapshot())
    assert poses.gradient_is_finite()
    np.testing.assert_array_equal(poses.world_to_camera().numpy(), path.astype(np.float32))


@pytest.mark.parametrize(("unit", "length"), [("median depth", 1.0), ("path diameter", 4.0), ("path cube", 2.5)])
def test_translations_step_in_their_unit_and_rotations_in_radians(unit, length):
    path = np.tile(np.eye(4), (4, 1, 1))
    path[:, 0, 3] = [0.0, -1.0, -1.0, -4.0]  # centres 0, 1, 1, 4, of mean 1.5
    poses = PoseCorrections(path, PoseSettings(every=1, rate=0.01, unit=unit))
    push(poses, torch.ones(4, 6))
    poses.step(0.0)
    moved = se3.log(poses.world_to_camera() @ torch.linalg.inv(torch.from_numpy(path).float())).detach()
    np.testing.assert_allclose(moved[:, :3], -0.01 * length, rtol=1e-3)
    np.testing.assert_allclose(moved[:, 3:], -0.01, rtol=1e-3)


def test_a_path_that_hardly_moves_has_a_length_all_the_same():
    still = np.tile(np.eye(4), (3, 1, 1))
    assert [length_of(unit, still) for unit in ("path diameter", "path cube")] == [0.02, 0.01]


def test_a_step_is_taken_once_in_every_so_many_iterations(path):
    poses = PoseCorrections(path, PoseSettings(every=4))
    moved = []
    for _ in range(9):
        before = poses.snapshot()
        push(poses, torch.ones(VIEWS, 6))
        poses.step(0.0)
        moved.append(not torch.equal(poses.snapshot(), before))
    assert moved == [False, False, False, True, False, False, False, True, False]


def test_the_step_follows_the_mean_of_the_accumulated_gradients(path):
    draw = torch.Generator().manual_seed(2)
    gradients = [torch.randn(VIEWS, 6, generator=draw) for _ in range(6)]
    gathered = PoseCorrections(path, PoseSettings(every=3))
    plain = torch.zeros(VIEWS, 6)
    adam = torch.optim.Adam([plain], lr=PoseSettings().rate, eps=1e-15)
    for i, gradient in enumerate(gradients):
        push(gathered, gradient)
        gathered.step(0.0)
        if i == 2:
            # By then the twists are still zero, where the gradient by the twist is the gradient given.
            plain.grad = torch.stack(gradients[:3]).mean(dim=0)
            adam.step()
            torch.testing.assert_close(gathered.snapshot(), plain, rtol=1e-4, atol=1e-7)


def test_the_step_size_falls_from_the_first_to_the_final_rate(path):
    settings = PoseSettings(every=1, rate=1e-3, final_rate=1e-5)
    for progress, damping, rate in ((0.0, 1.0, 1e-3), (0.5, 1.0, 1e-4), (1.0, 1.0, 1e-5), (0.5, 0.5, 5e-5)):
        poses = PoseCorrections(path, settings)
        push(poses, torch.ones(VIEWS, 6))
        poses.step(progress, damping)
        torch.testing.assert_close(poses.snapshot(), torch.full((VIEWS, 6), -rate), rtol=1e-3, atol=0)


def test_told_poses_settle_where_the_measurement_and_their_errors_balance(path):
    """A quadratic objective with its minimum one unit off: the posterior's mode is a weighted mean."""
    told = PoseErrors(position=0.02, rotation=0.005)
    settings = PoseSettings(rate=3e-3, final_rate=3e-6, given_weight=1e-3)
    poses = PoseCorrections(path, settings, told)
    errors = torch.tensor([0.02] * 3 + [0.005] * 3)

    def data(moved):
        twists = se3.log(moved @ torch.linalg.inv(torch.from_numpy(path).float()))
        return settings.given_weight * (((twists - 0.01) / errors) ** 2).mean()

    for i in range(600):
        poses.penalty().backward()
        pull(poses, data)
        poses.step(i / 600)
    moved = se3.log(poses.world_to_camera() @ torch.linalg.inv(torch.from_numpy(path).float())).detach()
    torch.testing.assert_close(moved, torch.full((VIEWS, 6), 0.005), rtol=0.02, atol=0)


def test_the_first_step_of_a_told_pose_is_short_beside_its_error(path):
    poses = PoseCorrections(path, PoseSettings(), PoseErrors(position=1e-3, rotation=1e-4))
    push(poses, torch.ones(VIEWS, 6))
    poses.step(0.0)
    moved = se3.log(poses.world_to_camera() @ torch.linalg.inv(torch.from_numpy(path).float())).detach()
    assert 0 < moved[:, :3].abs().max() < 0.5e-3
    assert 0 < moved[:, 3:].abs().max() < 0.5e-4


@pytest.mark.parametrize("case", ["untold", "weightless", "fixed"])
def test_without_errors_a_weight_or_refinement_nothing_is_unlikely(path, case):
    told = None if case == "untold" else PoseErrors(1e-3, 1e-3)
    settings = PoseSettings(refine=case != "fixed", given_weight=0.0 if case == "weightless" else 1e-3)
    assert PoseCorrections(path, settings, told).penalty() == 0.0


def test_a_step_without_any_gradient_does_nothing(path):
    poses = PoseCorrections(path, PoseSettings(every=1))
    poses.step(0.0)
    assert torch.equal(poses.snapshot(), torch.zeros(VIEWS, 6))


def test_a_bad_gradient_is_noticed_and_forgotten(path):
    poses = PoseCorrections(path, PoseSettings(every=2))
    push(poses, torch.ones(VIEWS, 6))
    poses.step(0.0)
    push(poses, torch.full((VIEWS, 6), float("nan")))
    assert not poses.gradient_is_finite()
    poses.restore(poses.snapshot())
    assert poses.gradient_is_finite()
    push(poses, torch.ones(VIEWS, 6))
    poses.step(0.0)
    assert torch.equal(poses.snapshot(), torch.zeros(VIEWS, 6))  # the count began anew


def test_restoring_goes_back_and_forgets_the_momentum(path):
    poses = PoseCorrections(path, PoseSettings(every=1))
    start = poses.snapshot()
    for _ in range(5):
        push(poses, torch.ones(VIEWS, 6))
        poses.step(0.0)
    assert not torch.equal(poses.snapshot(), start)
    poses.restore(start)
    assert torch.equal(poses.snapshot(), start)
    push(poses, -torch.ones(VIEWS, 6))
    poses.step(0.0)
    torch.testing.assert_close(poses.snapshot(), torch.full((VIEWS, 6), PoseSettings().rate), rtol=1e-3, atol=0)


def test_corrected_poses_are_rigid(path):
    poses = PoseCorrections(path, PoseSettings(every=1, rate=0.1))
    for seed in range(20):
        push(poses, torch.randn(VIEWS, 6, generator=torch.Generator().manual_seed(seed)))
        poses.step(0.0)
    rotations = poses.world_to_camera().detach()[:, :3, :3]
    torch.testing.assert_close(rotations @ rotations.mT, torch.eye(3).expand(VIEWS, 3, 3), rtol=0, atol=1e-5)

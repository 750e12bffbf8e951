import subprocess
import sys

import torch

from gs2ci.reconstruct.fit.optimiser.adam import Adam


def test_its_steps_are_those_of_torchs_own():
    draw = torch.Generator().manual_seed(0)
    ours = torch.randn(20, 3, generator=draw).requires_grad_(True)
    theirs = ours.detach().clone().requires_grad_(True)
    adam, reference = Adam(), torch.optim.Adam([theirs], lr=0.1, eps=1e-15)
    for _ in range(30):
        gradient = torch.randn(20, 3, generator=draw) * 1e-9
        ours.grad, theirs.grad = gradient.clone(), gradient.clone()
        adam.step(ours, 0.1)
        reference.step()
    torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6)


def test_a_parameter_without_a_gradient_stays():
    parameter = torch.ones(3)
    Adam().step(parameter, 1.0)
    assert torch.equal(parameter, torch.ones(3))


def test_moments_go_along_with_their_rows_and_newcomers_begin_anew():
    def stepped(follow, rows):
        parameter, adam = torch.zeros(3), Adam()
        parameter.grad = torch.tensor([1.0, -2.0, 0.5])
        adam.step(parameter, 0.1)
        adam.follow(torch.tensor(follow), forget=False)
        other = torch.zeros(rows)
        other.grad = torch.zeros(rows)
        adam.step(other, 0.1)
        return other

    moved = stepped([2, -1, 0, 0], 4)
    assert moved[1] == 0
    # Momentum alone carries on: against the sign of the gradient, as far for each, since Adam takes sizes out.
    assert (moved[[0, 2, 3]] < -0.01).all()
    torch.testing.assert_close(moved[2], moved[3])
    torch.testing.assert_close(moved[0], moved[2])


def test_a_fit_imports_neither_torchs_compiler_nor_sympy():
    code = (
        "import sys, torch\n"
        "from gs2ci.reconstruct.fit.optimiser.poses import PoseCorrections, PoseSettings\n"
        "from gs2ci.reconstruct.fit.optimiser.gaussians import GaussianOptimiser, StepSizes\n"
        "from gs2ci.render.gaussians import Gaussians\n"
        "scene = Gaussians(*(torch.zeros(s) for s in ((2, 3), (2, 3), (2, 4), (2,), (2, 3))))\n"
        "optimiser = GaussianOptimiser(scene, StepSizes(), 1.0)\n"
        "optimiser.scene.means.sum().backward()\n"
        "optimiser.step(0.0)\n"
        "import numpy\n"
        "poses = PoseCorrections(numpy.eye(4)[None].repeat(2, 0), PoseSettings())\n"
        "poses.pull(poses.world_to_camera(), numpy.ones((2, 4, 4), numpy.float32))\n"
        "poses.step(0.0)\n"
        "from gs2ci.render.adjoint import pull_back\n"
        "moved = poses.world_to_camera().requires_grad_()\n"
        "pull_back([2 * moved], [torch.ones_like(moved)])\n"
        "sys.exit(not {'torch._dynamo', 'sympy'}.isdisjoint(sys.modules))\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

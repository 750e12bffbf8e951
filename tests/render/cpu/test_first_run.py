"""A kernel's machine code is made twice: for the process that compiles it, and for the disk. Both must agree."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import hashlib
import torch
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.gaussians import Gaussians

torch.set_num_threads(1)
draw = torch.Generator().manual_seed(0)
count, views, size = 200, 3, (24, 32)
scene = Gaussians(
    means=torch.rand(count, 3, generator=draw) - 0.5 + torch.tensor([0.0, 0.0, 1.5]),
    log_scales=0.4 * torch.randn(count, 3, generator=draw) - 3,
    quaternions=torch.randn(count, 4, generator=draw),
    opacity_logits=2 * torch.randn(count, generator=draw),
    colours=torch.rand(count, 3, generator=draw),
).map(lambda tensor: tensor.requires_grad_(True))
poses = torch.eye(4).repeat(views, 1, 1)
poses[:, 0, 3] = torch.tensor([-0.02, 0.0, 0.02])
poses.requires_grad_(True)
intrinsics = torch.tensor([[30.0, 0, 16], [0, 30, 12], [0, 0, 1]])
backend = CpuBackend()
coded = backend.coded(scene, poses, intrinsics, backend.code((torch.rand(views, *size, generator=draw) < 0.4).float()))
(coded * torch.randn(coded.shape, generator=draw)).sum().backward()
for name, tensor in {"coded": coded.detach(), "poses": poses.grad, **scene.map(lambda t: t.grad).parameters()}.items():
    print(name, hashlib.sha256(tensor.numpy().tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_the_run_that_compiles_gives_the_same_bits_as_the_runs_after_it(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    outputs = [
        subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    assert list(tmp_path.rglob("*.nbc")), "nothing was kept on disk"
    assert outputs[0].stdout == outputs[1].stdout
    assert outputs[0].stdout.count("\n") == 7

"""Machine code for cards that are not here: every kernel compiles, and none spills registers."""

import pytest

pytest.importorskip("warp", reason="Warp is not installed")

from gs2ci.reconstruct.fit.kernels.device import kernels
from gs2ci.reconstruct.fit.losses import device_loss_kernels
from gs2ci.reconstruct.geometry.depth import device_paths
from tests.benchmarks.gpu_kernels import ARCHITECTURES, compiled
from tests.nightly import but

KERNELS = {"project", "project_backward", "sum_poses", "emit", "find_ranges", "blend", "blend_backward", "gather"}
KERNELS |= {"stop_light"}


@pytest.mark.slow
@pytest.mark.parametrize("arch", but(1, sorted(ARCHITECTURES)))
def test_every_kernel_compiles_and_none_spills(arch):
    found = {one.name: one for one in compiled(arch)}
    modules = (kernels, device_loss_kernels, device_paths)
    assert set(found) == KERNELS | {one.key for module in modules for one in module.ALL}
    assert [one for one in found.values() if one.stack] == []

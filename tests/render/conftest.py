"""Scenes for the tests of the renderer, and how a fast path is held to the definition."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
import torch
from torch import Tensor

from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend
from tests.render.backends import FAST, to_the_end
from tests.render.reference import ReferenceBackend

MARGIN_MIN = 2e-5
"""Below this distance of an alpha to a threshold, float32 may fall on the other side of it."""


@dataclass(frozen=True)
class Case:
    scene: Gaussians
    poses: Tensor
    intrinsics: Tensor
    masks: Tensor

    @property
    def size(self) -> tuple[int, int]:
        return self.masks.shape[1], self.masks.shape[2]


def make_case(
    seed: int = 0, count: int = 40, views: int = 3, size: tuple[int, int] = (19, 23), open_share: float = 0.3
) -> Case:
    """A cloud of Gaussians a few pixels wide before cameras that move a little, under grey masks."""
    rng = np.random.default_rng(seed)
    height, width = size
    focal = 1.1 * max(size)
    depth = rng.uniform(2.0, 6.0, count)
    means = np.stack([*(rng.uniform(-0.6, 0.6, (2, count)) * depth * max(size) / focal), depth], axis=1)
    scales = (rng.uniform(0.6, 4.0, count) * depth / focal)[:, None] * np.exp(rng.normal(0, 0.5, (count, 3)))
    poses = np.tile(np.eye(4), (views, 1, 1))
    for pose in poses:
        a, b = rng.normal(0, 0.03, 2)
        turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        tilt = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
        pose[:3, :3], pose[:3, 3] = tilt @ turn, rng.normal(0, 0.1, 3)
    masks = (rng.random((views, height, width)) < open_share) * rng.uniform(0.2, 1.0, (views, height, width))
    scene = Gaussians(
        means=torch.tensor(means, dtype=torch.float32),
        log_scales=torch.tensor(np.log(scales), dtype=torch.float32),
        quaternions=torch.tensor(rng.normal(size=(count, 4)), dtype=torch.float32),
        opacity_logits=torch.tensor(rng.normal(0, 2, count), dtype=torch.float32),
        colours=torch.tensor(rng.uniform(-0.2, 1.2, (count, 3)), dtype=torch.float32),
    )
    intrinsics = torch.tensor([[focal, 0, 0.52 * width], [0, 1.03 * focal, 0.47 * height], [0, 0, 1]])
    return Case(
        scene,
        torch.tensor(poses, dtype=torch.float32),
        intrinsics.float(),
        torch.tensor(masks, dtype=torch.float32),
    )


@dataclass(frozen=True)
class Outcome:
    """Outputs and gradients of one rendering, by name."""

    values: dict[str, Tensor]

    def assert_finite(self) -> None:
        for name, value in self.values.items():
            assert torch.isfinite(value).all(), f"{name} is not finite"

    def assert_equal(self, other: "Outcome") -> None:
        for name, value in self.values.items():
            assert torch.equal(value, other.values[name]), f"{name} differs"

    def assert_near(self, definition: "Outcome", tolerance: float) -> None:
        """Hold every output and gradient to the definition, relative in the 2-norm."""
        self.assert_finite()
        for name, truth in definition.values.items():
            error = torch.linalg.vector_norm(self.values[name].double() - truth)
            scale = torch.linalg.vector_norm(truth)
            assert error <= tolerance * scale, f"{name}: {error:.3g} of {scale:.3g}"


def render(backend: Backend, case: Case, *, whole_views: bool = False) -> Outcome:
    """Render a case and differentiate a fixed random functional of the result."""
    exact = isinstance(backend, ReferenceBackend)
    dtype = torch.float64 if exact else torch.float32
    scene = case.scene.map(lambda t: t.detach().to(dtype).clone().requires_grad_())
    poses = case.poses.to(dtype).clone().requires_grad_()
    generator = torch.Generator().manual_seed(7)
    if whole_views:
        images, alphas = backend.views(scene, poses, case.intrinsics, case.size)
        outputs = {"images": images, "alphas": alphas}
    else:
        outputs = {"coded": backend.coded(scene, poses, case.intrinsics, backend.code(case.masks))}
    loss = sum(
        (out.double() * torch.randn(out.shape, generator=generator, dtype=torch.float64)).sum()
        for out in outputs.values()
    )
    loss.backward()
    gradients = {f"d {name}": tensor.grad for name, tensor in scene.parameters().items()}
    return Outcome({k: v.detach() for k, v in outputs.items()} | gradients | {"d poses": poses.grad})


def _hold_to_definition(name: str, case: Case, tolerance: float, *, whole_views: bool = False) -> None:
    reference = ReferenceBackend()
    truth = render(reference, case, whole_views=whole_views)
    assert reference.margin > MARGIN_MIN, f"choose another scene: margin {reference.margin:.2g}"
    truth.assert_finite()
    render(to_the_end(name), case, whole_views=whole_views).assert_near(truth, tolerance)


def _with_margin(build: Callable[[int], Case], *, whole_views: bool = False) -> Case:
    """Draw scenes until one keeps clear of the thresholds, where the image itself jumps."""
    for seed in range(200):
        case = build(seed)
        reference = ReferenceBackend()
        with torch.no_grad():
            if whole_views:
                reference.views(case.scene, case.poses, case.intrinsics, case.size)
            else:
                reference.coded(case.scene, case.poses, case.intrinsics, reference.code(case.masks))
        if reference.margin > 2 * MARGIN_MIN:
            return case
    raise AssertionError("no scene keeps clear of the thresholds")


@pytest.fixture
def make() -> Callable[..., Case]:
    return make_case


@pytest.fixture
def change() -> Callable[..., Case]:
    """Return a case with some of its scene's fields replaced."""

    def apply(case: Case, **fields: Tensor) -> Case:
        return replace(case, scene=Gaussians(**(case.scene.parameters() | fields)))

    return apply


@pytest.fixture
def run() -> Callable[..., Outcome]:
    return render


@pytest.fixture
def with_margin() -> Callable[..., Case]:
    return _with_margin


@pytest.fixture(params=FAST)
def fast(request: pytest.FixtureRequest) -> str:
    """The name of a renderer that is held to the definition."""
    return str(request.param)


@pytest.fixture
def hold_to_definition(fast: str) -> Callable[..., None]:
    return partial(_hold_to_definition, fast)

"""Pixels that look elsewhere than at their own centres: what every backend promises of them."""

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.cpu.layout import lay_out
from gs2ci.render.sampling import CanvasSampling
from gs2ci.render.settings import RasterSettings
from gs2ci.render.simd.vector import LANES
from tests.render.backends import BACKENDS, load_backend
from tests.render.reference import ReferenceBackend

TOLERANCE = 2e-5
"""As in `cpu/test_parity.py`."""


def centres(size):
    rows, columns = np.mgrid[: size[0], : size[1]] + 0.5
    return np.stack([columns, rows], axis=-1)


def scattered(size, seed=0, reach_px=3.0):
    """Places about the pixels' own, some of them outside the frame, several in one pixel."""
    return centres(size) + np.random.default_rng(seed).uniform(-reach_px, reach_px, (*size, 2))


def outcome(backend, case, sampling, *, coded, reuse=False):
    exact = backend.name == "reference"
    dtype = torch.float64 if exact else torch.float32
    scene = case.scene.map(lambda t: t.detach().to(dtype).clone().requires_grad_())
    poses = case.poses.to(dtype).clone().requires_grad_()
    if coded:
        shared = backend.reuse() if reuse else None
        coding = backend.code(case.masks, sampling)
        image = backend.coded(scene, poses, case.intrinsics, coding, reuse=shared)
    else:
        image, _ = backend.views(scene, poses, case.intrinsics, case.size, sampling=sampling)
    weights = torch.linspace(-1, 1, image.numel(), dtype=torch.float64).reshape(image.shape)
    (image.double() * weights).sum().backward()
    return [image.detach().double(), poses.grad.double(), *(t.grad.double() for t in scene.parameters().values())]


@pytest.mark.parametrize("coded", [True, False])
@pytest.mark.parametrize("reach_px", [0.4, 6.0])
@pytest.mark.parametrize("reuse", [True, False])
def test_the_fast_path_agrees_with_the_definition_wherever_pixels_look(coded, reach_px, reuse, make, fast):
    for seed in range(100):
        case = make(seed)
        sampling, reference = CanvasSampling.around(scattered(case.size, seed, reach_px)), ReferenceBackend()
        truth = outcome(reference, case, sampling, coded=coded)
        if reference.margin > 4e-5:  # clear of the thresholds, where the image itself jumps
            break
    backend = load_backend(fast, RasterSettings(termination_transmittance=0.0, relist_every=3))
    for mine, exact in zip(outcome(backend, case, sampling, coded=coded, reuse=reuse), truth, strict=True):
        assert torch.linalg.vector_norm(mine - exact) <= TOLERANCE * torch.linalg.vector_norm(exact)


@pytest.mark.parametrize("name", BACKENDS)
def test_looking_at_the_own_centres_is_a_pinhole(name, make):
    case, backend = make(), load_backend(name)
    sampling = CanvasSampling.around(centres(case.size))
    assert (sampling.canvas, sampling.origin) == (case.size, (0, 0))
    plain, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size)
    placed, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size, sampling=sampling)
    assert torch.equal(plain, placed)


@pytest.mark.parametrize("name", BACKENDS)
def test_places_on_the_lattice_show_what_a_larger_frame_shows_there(name, make):
    """A canvas is a frame whose camera matrix counts from another corner."""
    case, backend = make(size=(12, 15)), load_backend(name)
    shifted = CanvasSampling.around(centres(case.size) + np.array([-4, 3]))
    assert shifted.origin == (-4, 3)
    moved = case.intrinsics.clone()
    moved[0, 2], moved[1, 2] = moved[0, 2] + 4, moved[1, 2] - 3
    assert torch.allclose(shifted.intrinsics_of_canvas(case.intrinsics), moved)
    expected, _ = backend.views(case.scene, case.poses, moved, case.size)
    found, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size, sampling=shifted)
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("name", BACKENDS)
def test_the_coded_sum_is_that_of_the_views_wherever_pixels_look(name, make):
    case, backend = make(), load_backend(name)
    sampling = CanvasSampling.around(scattered(case.size))
    coded = backend.coded(case.scene, case.poses, case.intrinsics, backend.code(case.masks, sampling))
    images, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size, sampling=sampling)
    assert coded.shape == (*case.size, 3)
    torch.testing.assert_close(coded, (case.masks[..., None] * images).sum(0), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", BACKENDS)
def test_the_backward_pass_is_the_adjoint_of_the_rendering(name, make, change):
    """In the colours the rendering W is linear: <W c, y> = <c, W' y>."""
    case, backend = make(), load_backend(name)
    draw = torch.Generator().manual_seed(3)
    sampling, colours = (
        CanvasSampling.around(scattered(case.size)),
        torch.rand(case.scene.colours.shape, generator=draw),
    )
    case = change(case, colours=colours.requires_grad_())
    coded = backend.coded(case.scene, case.poses, case.intrinsics, backend.code(case.masks, sampling)).double()
    other = torch.randn(coded.shape, generator=draw, dtype=torch.float64)
    forward = (coded * other).sum()
    (adjoint,) = torch.autograd.grad(forward, colours)
    assert float((adjoint.double() * colours).sum().detach()) == pytest.approx(float(forward.detach()), rel=1e-5)


def test_the_first_look_at_the_same_places_is_remembered_and_others_are_not_taken_for_them(make):
    case, backend = make(), CpuBackend()
    one, other = (CanvasSampling.around(scattered(case.size, seed)) for seed in (0, 1))
    first, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size, sampling=one)
    second, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size, sampling=other)
    again, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size, sampling=one)
    assert torch.equal(first, again)
    assert not torch.equal(first, second)


def test_each_pixel_lies_in_a_cell_of_the_column_it_looks_at():
    size = (9, 14)
    sampling = CanvasSampling.around(scattered(size))
    masks = (np.random.default_rng(1).random((2, *size)) < 0.6).astype(np.float32)
    layout = lay_out(masks, 3, sampling)
    assert (layout.height, layout.width) == sampling.canvas
    assert layout.size == size
    seen = np.zeros_like(masks)
    for view in range(2):
        lanes = np.arange(layout.cell_start[view] * LANES, layout.cell_start[view + 1] * LANES)
        np.add.at(seen[view].reshape(-1), layout.pixel[lanes], layout.weight[lanes])
        places = sampling.places.reshape(-1, 2)[layout.pixel[lanes]].astype(np.float32)
        np.testing.assert_array_equal(np.stack([layout.x[lanes], layout.y[lanes]], axis=1), places)
        cells = lanes // LANES - layout.cell_start[view]
        strip, column = (places[:, 1].astype(int) // 3, places[:, 0].astype(int))
        assert (layout.first[view, strip, column] <= cells).all()
        assert (cells <= layout.last[view, strip, column]).all()
    np.testing.assert_array_equal(seen, masks)


def test_a_canvas_holds_every_place_and_the_border_asked_for():
    sampling = CanvasSampling.around(np.array([[[-2.5, 3.0], [7.0, 4.999]]]), border=2)
    assert sampling.origin == (-5, 1)
    assert sampling.canvas == (6, 15)
    np.testing.assert_allclose(sampling.places, [[[2.5, 2.0], [12.0, 3.999]]])


@pytest.mark.parametrize(
    "places", [np.zeros((4, 2)), np.zeros((3, 4, 3)), np.zeros((0, 4, 2)), np.full((2, 2, 2), np.nan)]
)
def test_places_that_are_none_are_refused(places):
    with pytest.raises(InputError, match=r"finite numbers, \[H, W, 2\]"):
        CanvasSampling.around(places)


@pytest.mark.parametrize("name", BACKENDS)
def test_places_for_an_image_of_another_size_are_refused(name, make):
    case, backend = make(), load_backend(name)
    other = CanvasSampling.around(centres((3, 4)))
    with pytest.raises(InputError, match=r"positions of \(3, 4\) pixels"):
        backend.code(case.masks, other)
    with pytest.raises(InputError, match=r"positions of \(3, 4\) pixels"):
        backend.views(case.scene, case.poses, case.intrinsics, case.size, sampling=other)

"""ONNX denoisers of every signature that is understood, and every way in which a file can be wrong."""

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, plug_and_play
from gs2ci.reconstruct.learned.onnx_denoiser import OnnxDenoiser

MINUS_SIGMA = [("Sub", ["noisy", "sigma"], ["denoised"])]
BLIND = [("Relu", ["noisy"], ["denoised"])]


def constant(name, values, kind=np.int64):
    return numpy_helper.from_array(np.array(values, kind), name)


@pytest.fixture
def views():
    return np.random.default_rng(0).random((3, 1, 16, 24)).astype(np.float32)


@pytest.mark.parametrize("sigma", [(), (1,), ("n", 1, 1, 1), (1, 1, 1, 1), ("n", 1, "h", "w"), (1, 1, 16, 24)])
def test_sigma_comes_in_the_shape_that_the_model_asks_for(make_model, views, sigma):
    denoise = OnnxDenoiser(make_model(MINUS_SIGMA, sigma=sigma))
    np.testing.assert_allclose(denoise(views, 0.25), views - 0.25, atol=1e-6)


def test_sigma_comes_one_for_each_image_of_a_batch(make_model, views):
    nodes = [("Reshape", ["sigma", "per_image"], ["s"]), ("Sub", ["noisy", "s"], ["denoised"])]
    model = make_model(
        nodes,
        image=(2, 1, "h", "w"),
        sigma=(2,),
        out=(2, 1, "h", "w"),
        constants=[constant("per_image", [-1, 1, 1, 1])],
    )
    np.testing.assert_allclose(OnnxDenoiser(model)(views, 0.25), views - 0.25, atol=1e-6)


def test_a_blind_model_needs_no_sigma(make_model, views):
    denoise = OnnxDenoiser(make_model(BLIND, sigma=None))
    np.testing.assert_array_equal(denoise(views - 0.5, 0.1), np.maximum(views - 0.5, 0))


@pytest.mark.parametrize("size", [(1, 1), (15, 17), (3, 40), (16, 24)])
def test_images_of_any_size_keep_it(make_model, size):
    """The model itself only takes sides that it can halve three times."""
    nodes = [
        ("SpaceToDepth", ["noisy"], ["small"], {"blocksize": 8}),
        ("DepthToSpace", ["small"], ["denoised"], {"blocksize": 8}),
    ]
    images = np.random.default_rng(0).random((2, 1, *size)).astype(np.float32)
    assert np.array_equal(OnnxDenoiser(make_model(nodes, sigma=None))(images, 0.1), images)


@pytest.mark.parametrize("n", [1, 4, 5])
def test_a_fixed_batch_is_filled_up(make_model, n):
    shape = (4, 1, "h", "w")
    images = np.random.default_rng(0).random((n, 1, 8, 8)).astype(np.float32)
    assert np.array_equal(OnnxDenoiser(make_model(BLIND, image=shape, sigma=None, out=shape))(images, 0.1), images)


def test_a_grey_model_takes_colours_one_by_one(make_model):
    shape = ("n", 1, "h", "w")
    images = np.random.default_rng(0).random((2, 3, 8, 8)).astype(np.float32)
    denoise = OnnxDenoiser(make_model(MINUS_SIGMA, image=shape, sigma=(), out=shape))
    np.testing.assert_allclose(denoise(images, 0.5), images - 0.5, atol=1e-6)


def test_a_colour_model_sees_grey_images_three_times(make_model, views):
    """It scales its channels by 1, 2 and 3: their mean is twice the image."""
    shape = ("n", 3, "h", "w")
    gains = numpy_helper.from_array(np.array([1, 2, 3], np.float32).reshape(1, 3, 1, 1), "gains")
    nodes = [("Mul", ["noisy", "gains"], ["denoised"])]
    denoise = OnnxDenoiser(make_model(nodes, image=shape, sigma=None, out=shape, constants=[gains]))
    np.testing.assert_allclose(denoise(views, 0.1), 2 * views, rtol=1e-6)


def test_a_colour_model_is_told_that_noise_in_grey_images_is_the_same_in_all_channels(make_model, views):
    shape = ("n", 3, "h", "w")
    denoise = OnnxDenoiser(make_model(MINUS_SIGMA, image=shape, sigma=(), out=shape))
    np.testing.assert_allclose(denoise(views, 0.25), views - 0.25 * 3**0.5, atol=1e-6)
    coloured = np.concatenate([views] * 3, axis=1)
    np.testing.assert_allclose(denoise(coloured, 0.25), coloured - 0.25, atol=1e-6)


def test_a_model_decodes_a_shot(make_model, make_shot):
    """A 3 x 3 mean is a denoiser, if not a good one."""
    mean = numpy_helper.from_array(np.full((1, 1, 3, 3), 1 / 9, np.float32), "mean")
    shape = ("n", 1, "h", "w")
    nodes = [("Conv", ["noisy", "mean"], ["denoised"], {"pads": [1, 1, 1, 1]})]
    denoise = OnnxDenoiser(make_model(nodes, image=shape, sigma=None, out=shape, constants=[mean]))
    shot = make_shot(size=(31, 37))
    views = plug_and_play(shot, denoise, PlugAndPlaySettings(iterations=4))
    assert np.abs(views - shot.truth.views)[:, 2:-2, 2:-2].mean() < 0.05


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match="no model file"):
        OnnxDenoiser(tmp_path / "absent.onnx")


def test_a_file_that_is_no_model_is_named(tmp_path):
    (tmp_path / "notes.onnx").write_bytes(b"not a model at all")
    with pytest.raises(InputError, match=r"notes\.onnx cannot be loaded"):
        OnnxDenoiser(tmp_path / "notes.onnx")


def test_an_unknown_operator_set_is_named(make_model):
    with pytest.raises(InputError, match="cannot be loaded") as caught:
        OnnxDenoiser(make_model(BLIND, sigma=None, opset=999))
    assert "operator set" in caught.value.remedy


@pytest.mark.parametrize(
    "signature",
    [
        {"image": ("n", "h", "w"), "sigma": None, "out": ("n", "h", "w")},
        {"image": ("n", 4, "h", "w"), "sigma": None, "out": ("n", 4, "h", "w")},
        {"kind": TensorProto.DOUBLE, "sigma": None},
        {"sigma": ("n", 1)},
    ],
)
def test_other_signatures_are_no_denoisers(tmp_path, make_model, signature):
    nodes = BLIND if signature.get("kind") is None else [("Cast", ["noisy"], ["denoised"], {"to": TensorProto.FLOAT})]
    with pytest.raises(InputError, match="is not a denoiser: it takes noisy"):
        OnnxDenoiser(make_model(nodes, **signature))


def test_three_inputs_are_no_denoiser(tmp_path):
    shape = ["n", 1, "h", "w"]
    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("a", "b", "c", "d")]
    graph = helper.make_graph([helper.make_node("Sum", ["a", "b", "c"], ["d"])], "three", values[:3], values[3:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    (tmp_path / "three.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(InputError, match="is not a denoiser"):
        OnnxDenoiser(tmp_path / "three.onnx")


@pytest.mark.parametrize("sides", [(16, 24), (32, 32)])
def test_a_fixed_image_size_is_filled_up(make_model, views, sides):
    shape = ("n", 1, *sides)
    assert np.array_equal(OnnxDenoiser(make_model(BLIND, image=shape, sigma=None, out=shape))(views, 0.1), views)


def test_an_image_larger_than_the_models_fixed_size_is_refused(make_model, views):
    shape = ("n", 1, 32, 16)
    denoise = OnnxDenoiser(make_model(BLIND, image=shape, sigma=None, out=shape))
    with pytest.raises(InputError, match="takes images of 32 x 16 pixels, not of 16 x 24"):
        denoise(views, 0.1)


def test_an_answer_of_another_shape_is_refused(make_model, views):
    nodes = [("SpaceToDepth", ["noisy"], ["denoised"], {"blocksize": 2})]
    with pytest.raises(NumericsError, match=r"made \[1, 4, 8, 12\] of images \[1, 1, 16, 24\]"):
        OnnxDenoiser(make_model(nodes, sigma=None))(views, 0.1)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_answer_that_is_not_finite_is_refused(make_model, views, value):
    nodes = [("Mul", ["noisy", "value"], ["denoised"])]
    model = make_model(nodes, sigma=None, constants=[constant("value", value, np.float32)])
    with pytest.raises(NumericsError, match=r"not finite at sigma 0\.1"):
        OnnxDenoiser(model)(views, 0.1)


def test_a_model_that_fails_on_the_image_is_named(make_model, views):
    nodes = [("Reshape", ["noisy", "seven"], ["denoised"])]
    model = make_model(nodes, sigma=None, constants=[constant("seven", [7, 7])], out=("a", "b"))
    with pytest.raises(NumericsError, match=r"small\.onnx failed on noisy \[1, 1, 16, 24\]"):
        OnnxDenoiser(model)(views, 0.1)

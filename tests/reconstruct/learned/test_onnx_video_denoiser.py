"""Video denoisers of every understood signature, and files and answers that are none."""

import numpy as np
import pytest
from onnx import TensorProto, helper, save

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.reconstruct.learned.onnx_denoiser import OnnxDenoiser
from gs2ci.reconstruct.learned.onnx_video_denoiser import OnnxVideoDenoiser, open_denoiser


@pytest.fixture
def model(tmp_path):
    """Write a model that gives the mean of its frames plus sigma, or what `operator` makes of the mean."""

    def make(frames=("n", 3, 1, "h", "w"), sigma=("n",), operator=None, kind=TensorProto.FLOAT, keep=0, more=()):
        inputs = [helper.make_tensor_value_info("frames", kind, frames)]
        if sigma is not None:
            inputs.append(helper.make_tensor_value_info("sigma", TensorProto.FLOAT, sigma))
        nodes = [helper.make_node("ReduceMean", ["frames"], ["mean"], axes=[1], keepdims=keep)]
        if operator:
            nodes.append(helper.make_node(operator, ["mean"], ["denoised"]))
        else:
            nodes.append(helper.make_node("Add", ["mean", "sigma" if sigma is not None else "mean"], ["denoised"]))
        out = helper.make_tensor_value_info("denoised", kind, [None] * (5 if keep else 4))
        graph = helper.make_graph(nodes, "video", inputs, [out], list(more))
        proto = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
        proto.ir_version = 8
        save(proto, tmp_path / "video.onnx")
        return tmp_path / "video.onnx"

    return make


def stack(views=4, channels=1, size=(5, 11)):
    return np.random.default_rng(0).random((views, channels, *size)).astype(np.float32)


@pytest.mark.parametrize("views", [1, 2, 5])
@pytest.mark.parametrize("sigma", [(), (1,), ("n",)])
def test_each_view_is_denoised_with_its_neighbours_and_the_ends_are_mirrored(model, views, sigma):
    given = stack(views)
    around = [
        given[[abs(i - 1) if views > 1 else 0, i, min(i + 1, 2 * views - 3 - i) if views > 1 else 0]]
        for i in range(views)
    ]
    expected = np.stack([frames.mean(0) for frames in around]) + 0.25
    np.testing.assert_allclose(OnnxVideoDenoiser(model(sigma=sigma))(given, 0.25), expected, atol=1e-6)


@pytest.mark.parametrize(("takes", "given"), [(1, 3), (3, 1), (3, 3)])
def test_grey_and_colour_models_take_grey_and_colour_views(model, takes, given):
    views = stack(3, given)
    denoised = OnnxVideoDenoiser(model(frames=("n", 3, takes, "h", "w")))(views, 0.0)
    assert denoised.shape == views.shape
    np.testing.assert_allclose(denoised[1], views.mean(0), atol=1e-6)


@pytest.mark.parametrize(
    "signature",
    [
        {"frames": ("n", 4, 1, "h", "w")},
        {"frames": ("n", "f", 1, "h", "w")},
        {"frames": ("n", 3, 2, "h", "w")},
        {"frames": (2, 3, 1, "h", "w")},
        {"frames": ("n", 3, 1, 8, 8)},
        {"sigma": None},
        {"sigma": ("n", 1)},
        {"kind": TensorProto.DOUBLE, "operator": "Relu"},
    ],
)
def test_other_signatures_are_refused(model, signature):
    with pytest.raises(InputError, match="is not a video denoiser"):
        OnnxVideoDenoiser(model(**signature))


def test_answers_of_another_shape_are_named(model):
    with pytest.raises(NumericsError, match="of frames"):
        OnnxVideoDenoiser(model(keep=1))(stack(), 0.1)


def test_answers_that_are_not_finite_are_named(model):
    with pytest.raises(NumericsError, match=r"not finite at sigma 0\.1"):
        OnnxVideoDenoiser(model(operator="Log"))(-stack(), 0.1)


def test_a_denoiser_is_opened_as_what_it_is(model, make_model):
    assert isinstance(open_denoiser(model()), OnnxVideoDenoiser)
    assert isinstance(open_denoiser(make_model([("Identity", ["noisy"], ["denoised"])], sigma=None)), OnnxDenoiser)
    with pytest.raises(InputError, match="no model file"):
        open_denoiser(model().parent / "absent.onnx")

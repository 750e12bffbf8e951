"""Image-to-image models of every signature that is understood, and every way in which a file can be wrong."""

from dataclasses import replace

import numpy as np
import pytest
from onnx import TensorProto, numpy_helper

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.reconstruct.learned.onnx_models import add_model
from gs2ci.reconstruct.paper.priors2d.choose import load_prior
from gs2ci.reconstruct.paper.priors2d.onnx_prior import OnnxPrior

OPEN = (1, 3, "h", "w")
NEGATE = [("Neg", ["image"], ["out"])]


def constant(name, values, kind=np.float32):
    return numpy_helper.from_array(np.array(values, kind), name)


@pytest.fixture
def image_model(write_model):
    def make(nodes=NEGATE, *, image=OPEN, seed=None, out=OPEN, constants=(), kind=TensorProto.FLOAT, **more):
        inputs = [("image", image, kind)] + ([] if seed is None else [("seed", seed, TensorProto.INT64)])
        return write_model(nodes, inputs, [("out", out)], constants, **more)

    return make


def test_values_go_in_and_come_out_between_minus_one_and_one(image_model, question):
    """Negation turns [−1, 1] around, and [0, 1] inside out."""
    targets = OnnxPrior(image_model())(question)
    np.testing.assert_allclose(targets, 1 - np.clip(question.pseudo.images, 0, 1), atol=1e-6)


def test_sides_are_padded_to_multiples_of_eight_and_cropped(image_model, question):
    """The model itself only takes sides that it can halve three times; a view has 20 rows."""
    nodes = [
        ("SpaceToDepth", ["image"], ["small"], {"blocksize": 8}),
        ("DepthToSpace", ["small"], ["out"], {"blocksize": 8}),
    ]
    assert question.pseudo.images.shape[1] % 8
    np.testing.assert_allclose(
        OnnxPrior(image_model(nodes))(question), np.clip(question.pseudo.images, 0, 1), atol=1e-6
    )


@pytest.mark.parametrize("shape", [(), (1,)])
def test_each_view_gets_a_seed_of_its_own(image_model, question, shape):
    nodes = [
        ("Cast", ["seed"], ["number"], {"to": TensorProto.FLOAT}),
        ("Mul", ["image", "zero"], ["nothing"]),
        ("Mul", ["number", "tenth"], ["shift"]),
        ("Add", ["nothing", "shift"], ["out"]),
    ]
    model = image_model(nodes, seed=shape, constants=[constant("zero", 0), constant("tenth", 0.1)])
    two = replace(question, pseudo=replace(question.pseudo, images=np.repeat(question.pseudo.images, 2, axis=0)))
    targets = OnnxPrior(model, seed=2)(two)
    np.testing.assert_allclose([targets[0].mean(), targets[1].mean()], [0.6, 0.65], atol=1e-6)


def test_a_fixed_size_that_fits_is_taken_and_one_that_is_too_small_is_refused(image_model, question):
    larger = OnnxPrior(image_model(image=(1, 3, 24, 32), out=(1, 3, 24, 32)))
    assert larger(question).shape == question.pseudo.images.shape
    smaller = OnnxPrior(image_model(image=(1, 3, 16, 32), out=(1, 3, 16, 32)))
    with pytest.raises(InputError, match="takes images of 16 x 32 pixels, not of 20 x 32"):
        smaller(question)


@pytest.mark.parametrize(
    "signature",
    [
        {"image": (3, "h", "w"), "out": (3, "h", "w")},
        {"image": (1, 4, "h", "w"), "out": (1, 4, "h", "w")},
        {"image": (2, 3, "h", "w"), "out": (2, 3, "h", "w")},
        {"seed": (2,)},
    ],
)
def test_other_signatures_are_no_priors(image_model, signature):
    with pytest.raises(InputError, match="is not a prior on images: it takes image"):
        OnnxPrior(image_model(**signature))


def test_integers_are_no_images(image_model):
    nodes = [("Cast", ["image"], ["out"], {"to": TensorProto.FLOAT})]
    with pytest.raises(InputError, match="is not a prior on images"):
        OnnxPrior(image_model(nodes, kind=TensorProto.UINT8))


def test_a_missing_file_and_an_unknown_operator_set_are_named(tmp_path, image_model):
    with pytest.raises(InputError, match="no model file"):
        OnnxPrior(tmp_path / "absent.onnx")
    with pytest.raises(InputError, match="cannot be loaded"):
        OnnxPrior(image_model(opset=999))


def test_an_answer_of_another_shape_is_refused(image_model, question):
    model = image_model([("SpaceToDepth", ["image"], ["out"], {"blocksize": 2})], out=(1, 12, "h", "w"))
    with pytest.raises(NumericsError, match="made"):
        OnnxPrior(model)(question)


def test_an_answer_that_is_not_finite_is_refused(image_model, question):
    model = image_model([("Mul", ["image", "value"], ["out"])], constants=[constant("value", np.nan)])
    with pytest.raises(NumericsError, match="not finite"):
        OnnxPrior(model)(question)


def test_priors_are_loaded_by_name(image_model, monkeypatch, tmp_path):
    monkeypatch.setenv("GS2CI_HOME", str(tmp_path / "home"))
    assert load_prior("none", 0) is None
    assert load_prior("difix-or-none", 0) is None
    assert load_prior(f"onnx:{image_model()}", 0).name == "small.onnx"
    with pytest.raises(InputError, match="no difix model"):
        load_prior("difix", 0)
    add_model("difix", image_model())
    assert {load_prior(name, 0).name for name in ("difix", "difix-or-none")} == {"small.onnx"}
    with pytest.raises(InputError, match="prior 'dream'"):
        load_prior("dream", 0)

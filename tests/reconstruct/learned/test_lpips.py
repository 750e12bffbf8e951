"""A small network of LPIPS's signature and operators, against the same network in torch."""

import sys

import numpy as np
import pytest
import torch
from onnx import TensorProto, numpy_helper

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.learned.lpips import Lpips

PAIR = [("a", (1, 3, "h", "w")), ("b", (1, 3, "h", "w"))]
ONE = [("distance", (1, 1, 1, 1))]


def weights():
    rng = np.random.default_rng(0)
    return {
        "shift": np.array([-0.03, -0.09, -0.19], np.float32).reshape(1, 3, 1, 1),
        "scale": np.array([0.46, 0.45, 0.45], np.float32).reshape(1, 3, 1, 1),
        "kernel": rng.normal(0, 0.3, (5, 3, 3, 3)).astype(np.float32),
        "bias": rng.normal(0, 0.1, 5).astype(np.float32),
        "linear": rng.random((1, 5, 1, 1)).astype(np.float32),
        "epsilon": np.float32(1e-10),
        "two": np.float32(2),
    }


def nodes(opset):
    """What the original's export looks like: scaling, features, unit length, squared differences, mean."""
    reduce_axes = ["channels"] if opset >= 13 else []
    steps = []
    for x in "ab":
        steps += [
            ("Sub", [x, "shift"], [f"{x}1"]),
            ("Div", [f"{x}1", "scale"], [f"{x}2"]),
            ("Conv", [f"{x}2", "kernel", "bias"], [f"{x}3"], {"pads": [1, 1, 1, 1], "kernel_shape": [3, 3]}),
            ("Relu", [f"{x}3"], [f"{x}4"]),
            ("MaxPool", [f"{x}4"], [f"{x}5"], {"kernel_shape": [2, 2], "strides": [2, 2]}),
            ("Pow", [f"{x}5", "two"], [f"{x}6"]),
            ("ReduceSum", [f"{x}6", *reduce_axes], [f"{x}7"], {"keepdims": 1}),
            ("Sqrt", [f"{x}7"], [f"{x}8"]),
            ("Add", [f"{x}8", "epsilon"], [f"{x}9"]),
            ("Div", [f"{x}5", f"{x}9"], [f"{x}10"]),
        ]
    return [
        *steps,
        ("Sub", ["a10", "b10"], ["d"]),
        ("Mul", ["d", "d"], ["dd"]),
        ("Conv", ["dd", "linear"], ["weighed"]),
        ("ReduceMean", ["weighed"], ["mean"], {"axes": [2, 3], "keepdims": 1}),
        ("Identity", ["mean"], ["distance"]),
    ]


def in_torch(image, target):
    tensors = {name: torch.from_numpy(np.array(value)) for name, value in weights().items()}
    unit = []
    for seen in (image, target):
        scaled = (seen.permute(2, 0, 1)[None] * 2 - 1 - tensors["shift"]) / tensors["scale"]
        features = torch.relu(torch.nn.functional.conv2d(scaled, tensors["kernel"], tensors["bias"], padding=1))
        pooled = torch.nn.functional.max_pool2d(features, 2)
        unit.append(pooled / ((pooled**2).sum(1, keepdim=True).sqrt() + 1e-10))
    return (tensors["linear"] * (unit[0] - unit[1]) ** 2).sum(1).mean()


@pytest.fixture
def model(write_model):
    def make(steps=None, inputs=PAIR, outputs=ONE, extra=(), opset=17):
        constants = [numpy_helper.from_array(np.array(value), name) for name, value in weights().items()]
        constants.append(numpy_helper.from_array(np.array([1]), "channels"))
        return write_model(steps or nodes(opset), inputs, outputs, [*constants, *extra], opset=opset)

    return make


@pytest.fixture
def pair():
    return torch.rand(2, 18, 14, 3, generator=torch.Generator().manual_seed(1))


def test_it_is_the_network_in_the_file(model, pair):
    assert float(Lpips(model())(*pair)) == pytest.approx(float(in_torch(*pair)), rel=1e-5)


def test_its_gradient_reaches_the_image_only(model, pair):
    image, target = (part.clone().requires_grad_() for part in pair)
    Lpips(model())(image, target).backward()
    again = pair[0].clone().requires_grad_()
    in_torch(again, pair[1]).backward()
    torch.testing.assert_close(image.grad, again.grad, rtol=1e-3, atol=1e-6)
    assert target.grad is None


def test_dead_features_have_a_finite_gradient(model):
    """Where all features are zero their length is, and the derivative of a root at zero is infinite."""
    dead = [*nodes(17)]
    dead[2] = ("Conv", ["a2", "kernel", "low"], ["a3"], {"pads": [1, 1, 1, 1]})
    low = numpy_helper.from_array(np.full(5, -100, np.float32), "low")
    image = torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(2)).requires_grad_()
    Lpips(model(dead, extra=[low]))(image, image.detach()).backward()
    assert torch.isfinite(image.grad).all()


def test_a_constant_may_stand_in_a_node(model, pair):
    steps = [("Constant", [], ["zero"], {"value_float": 0.0}), *nodes(17)[:-1], ("Add", ["mean", "zero"], ["distance"])]
    assert float(Lpips(model(steps))(*pair)) == pytest.approx(float(in_torch(*pair)), rel=1e-5)


def test_other_signatures_are_no_lpips(model):
    with pytest.raises(InputError, match="is not an LPIPS model: it takes a"):
        Lpips(model([("Relu", ["a"], ["distance"])], inputs=PAIR[:1], outputs=[("distance", (1, 3, "h", "w"))]))
    integers = [(name, shape, TensorProto.DOUBLE) for name, shape in PAIR]
    with pytest.raises(InputError, match="is not an LPIPS model"):
        Lpips(
            model([("Sub", ["a", "b"], ["distance"])], integers, [("distance", (1, 3, "h", "w"), TensorProto.DOUBLE)])
        )


def test_more_than_one_number_is_no_distance(model):
    with pytest.raises(InputError, match=r"returns \[1, 3, 64, 64\] of two images"):
        Lpips(model([("Sub", ["a", "b"], ["distance"])], outputs=[("distance", (1, 3, "h", "w"))]))


def test_an_operator_that_is_not_known_is_named(model):
    steps = [*nodes(17)[:-1], ("Sigmoid", ["mean"], ["distance"])]
    with pytest.raises(InputError, match="holds the operator Sigmoid"):
        Lpips(model(steps))


def test_an_operator_understood_otherwise_is_found_out(model):
    """Automatic padding is not read here; ONNX Runtime pads, torch would not."""
    steps = [*nodes(17)]
    for i in (2, 12):
        kind, inputs, outputs, _ = steps[i]
        steps[i] = (kind, inputs, outputs, {"auto_pad": "SAME_UPPER"})
    with pytest.raises(InputError, match="but in ONNX Runtime"):
        Lpips(model(steps))


def test_a_fixed_size_is_kept_to(model, pair):
    fixed = [(name, (1, 3, 16, 16)) for name, _ in PAIR]
    distance = Lpips(model(inputs=fixed))
    assert torch.isfinite(
        distance(pair[0, :16, :14].repeat(1, 2, 1)[:, :16], pair[1, :16, :14].repeat(1, 2, 1)[:, :16])
    )
    with pytest.raises(InputError, match="compares images of 16 x 16 pixels, not of 18 x 14"):
        distance(*pair)


def test_a_missing_file_and_a_missing_package_are_named(tmp_path, model, monkeypatch):
    with pytest.raises(InputError, match="no model file"):
        Lpips(tmp_path / "absent.onnx")
    path = model()
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InputError, match="needs the package onnx"):
        Lpips(path)

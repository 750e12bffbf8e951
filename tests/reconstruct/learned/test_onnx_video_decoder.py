"""A network from measurement and masks straight to views: micro networks, written here."""

from dataclasses import replace

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper, save

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.learned.onnx_video_decoder import OnnxVideoDecoder
from gs2ci.reconstruct.measurement.coding import cfa_channels

OPEN = (1, 1, "h", "w"), (1, "n", "h", "w"), (1, 1, "h", "w")


def value(name, shape):
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)


@pytest.fixture
def network(tmp_path):
    """Write a network: y / Φ_s in every view where its mask is open, times a factor; for colour, thrice."""

    def make(*, inputs=OPEN, colour=False, factor=1.0, rank=None):
        names = ["y", "phi", "total"][: len(inputs)]
        nodes = [
            helper.make_node("Div" if len(inputs) == 3 else "Identity", ["y", "total"][: len(inputs) - 1], ["mean"]),
            helper.make_node("Mul", ["mean", "phi"], ["coded"]),
            helper.make_node("Mul", ["coded", "factor"], ["scaled"]),
        ]
        constants = [numpy_helper.from_array(np.array(factor, np.float32), "factor")]
        if colour:
            constants.append(numpy_helper.from_array(np.array([1]), "axis"))
            nodes.append(helper.make_node("Unsqueeze", ["scaled", "axis"], ["one"]))
            nodes.append(helper.make_node("Concat", ["one", "one", "one"], ["views"], axis=1))
        else:
            nodes.append(helper.make_node("Identity", ["scaled"], ["views"]))
        out = [None] * (rank or (5 if colour else 4))
        graph = helper.make_graph(
            nodes, "micro", [value(n, s) for n, s in zip(names, inputs, strict=True)], [value("views", out)], constants
        )
        proto = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
        proto.ir_version = 8
        save(proto, tmp_path / "micro.onnx")
        return OnnxVideoDecoder(tmp_path / "micro.onnx")

    return make


def make_shot(channels=1, size=(22, 28), cfa=None):
    rng = np.random.default_rng(0)
    masks = (rng.random((4, *size)) < 0.5).astype(np.float32)
    masks[:, 1, 2] = 0
    weights = np.array([0.9, 1.0, 1.1, 1.0], np.float32)
    measurement = rng.random((*size, channels)).astype(np.float32) * masks.sum(axis=0)[..., None]
    return Shot(measurement, masks, weights, cfa=cfa).check()


def wanted(shot):
    """What the micro network says, [N, H, W, C]; in float64."""
    phi = (shot.masks * shot.weights[:, None, None]).astype(float)
    total = phi.sum(axis=0)
    total[total == 0] = 1
    return phi[..., None] * (shot.measurement / total[..., None])[None]


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("size", [(22, 28), (24, 32), (5, 3)])
def test_a_network_gets_measurement_masks_and_their_sum_and_gives_views(network, channels, size):
    shot = make_shot(channels, size)
    np.testing.assert_allclose(network()(shot), wanted(shot), atol=1e-6)


def test_a_network_that_takes_no_sum_gets_none(network):
    shot = make_shot()
    phi = shot.masks * shot.weights[:, None, None]
    np.testing.assert_allclose(network(inputs=OPEN[:2])(shot), phi[..., None] * shot.measurement[None], atol=1e-6)


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR"])
def test_a_grey_network_sees_the_four_lattices_of_a_mosaic_apart(network, cfa):
    shot = make_shot(cfa=cfa)
    views = network()(shot)
    assert views.shape == (4, 22, 28, 3)
    measured = np.take_along_axis(views, cfa_channels(cfa, shot.size).numpy()[None, ..., None], axis=3)
    np.testing.assert_allclose(measured, wanted(shot), atol=1e-6)


@pytest.mark.parametrize("cfa", ["RGGB", "GRBG", "GBRG", "BGGR"])
def test_a_colour_network_gets_a_mosaic_that_begins_red_green(network, cfa):
    """Only red pixels are lit: the network must find them where both coordinates are even."""
    shot = make_shot(cfa=cfa, size=(24, 32))
    red = cfa_channels(cfa, shot.size).numpy() == 0
    shot = replace(shot, measurement=np.where(red[..., None], shot.measurement, np.float32(0)))
    decode = network(colour=True)
    told = []
    inner = decode._session

    class Listener:
        def __getattr__(self, name):
            return getattr(inner, name)

        def run(self, names, feed):
            told.append(feed["y"][0, 0])
            return inner.run(names, feed)

    decode._session = Listener()
    views = decode(shot)
    assert (told[0][::2, ::2] > 0).any()
    told[0][::2, ::2] = 0
    assert not told[0].any()
    np.testing.assert_allclose(views, np.repeat(wanted(shot), 3, axis=3), atol=1e-6)


@pytest.mark.parametrize(("channels", "cfa", "size"), [(3, None, (24, 32)), (1, "RGGB", (23, 32))])
def test_a_colour_network_refuses_what_is_no_mosaic_of_even_sides(network, channels, cfa, size):
    with pytest.raises(InputError, match="decodes mosaics in colour"):
        network(colour=True)(make_shot(channels, size, cfa))


def test_a_mosaic_of_odd_sides_is_refused(network):
    with pytest.raises(InputError, match="a mosaic of 23 x 32"):
        network()(make_shot(1, (23, 32), "RGGB"))


@pytest.mark.parametrize(
    "masks", [(1, 8, "h", "w"), (1, "n", 16, "w"), (1, "n", "h", 16)], ids=["masks", "height", "width"]
)
def test_a_network_for_another_size_is_refused(network, masks):
    with pytest.raises(InputError, match="not 4 of 22 x 28"):
        network(inputs=(OPEN[0], masks, OPEN[2]))(make_shot())


@pytest.mark.parametrize(
    "inputs",
    [OPEN[:1], ((1, 3, "h", "w"), *OPEN[1:]), ((1, "h", "w"), *OPEN[1:])],
    ids=["one", "three channels", "rank"],
)
def test_files_of_another_signature_are_refused(network, inputs):
    with pytest.raises(InputError, match=r"is not a decoder of measurements|cannot be loaded"):
        network(inputs=inputs)


def test_an_output_of_another_rank_is_refused(network, tmp_path):
    graph = helper.make_graph(
        [helper.make_node("ReduceMean", ["phi"], ["views"], keepdims=0)],
        "micro",
        [value("y", OPEN[0]), value("phi", OPEN[1])],
        [value("views", [])],
    )
    proto = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    proto.ir_version = 8
    save(proto, tmp_path / "scalar.onnx")
    with pytest.raises(InputError, match="is not a decoder of measurements"):
        OnnxVideoDecoder(tmp_path / "scalar.onnx")


def test_numbers_that_are_not_finite_are_refused(network):
    with pytest.raises(NumericsError, match="not finite"):
        network(factor=np.inf)(make_shot())


def test_views_of_another_shape_are_refused(tmp_path):
    graph = helper.make_graph(
        [helper.make_node("Concat", ["phi", "phi"], ["views"], axis=1)],
        "micro",
        [value("y", OPEN[0]), value("phi", OPEN[1])],
        [value("views", [None] * 4)],
    )
    proto = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    proto.ir_version = 8
    save(proto, tmp_path / "twice.onnx")
    with pytest.raises(NumericsError, match=r"made \[1, 8, 24, 32\]"):
        OnnxVideoDecoder(tmp_path / "twice.onnx")(make_shot())

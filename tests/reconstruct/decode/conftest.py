import numpy as np
import pytest
import torch
from onnx import TensorProto, helper, save

from gs2ci.core.records import Shot, Truth
from gs2ci.reconstruct.coding import Coding


@pytest.fixture
def make_shot():
    """Code smooth views, the same for all or sliding from one to the next, under random masks."""

    def make(n=4, size=(32, 40), channels=1, *, slide=0.0, cfa=None, grey=False, noise=0.0, **parts):
        rng = np.random.default_rng(5)
        y, x = np.mgrid[: size[0], : size[1]] / 5
        moved = slide * np.arange(n)[:, None, None, None]
        shades = np.arange(3 if cfa else channels) * 0.4
        views = 0.5 + 0.35 * np.sin(x[None, ..., None] + moved + shades) * np.cos(y[None, ..., None] - shades)
        masks = rng.random((n, *size)) if grey else rng.random((n, *size)) < 0.5
        masks = masks.astype(np.float32)
        weights = np.ones(n, np.float32)
        blank = Shot(np.zeros((*size, 1 if cfa else channels), np.float32), masks, weights, cfa=cfa)
        coded = Coding.of(blank).forward(torch.from_numpy(views.astype(np.float32))).numpy()
        coded = coded + rng.normal(0, noise, coded.shape).astype(np.float32) if noise else coded
        return Shot(coded, masks, weights, cfa=cfa, truth=Truth(views.astype(np.float32)), **parts).check()

    return make


@pytest.fixture
def make_model(tmp_path):
    """Write a small ONNX model: `noisy` (and `sigma`) through the given nodes to `denoised`."""

    def make(
        nodes,
        *,
        image=("n", "c", "h", "w"),
        sigma=("n",),
        out=("n", "c", "h", "w"),
        constants=(),
        opset=17,
        kind=TensorProto.FLOAT,
    ):
        inputs = [helper.make_tensor_value_info("noisy", kind, image)]
        if sigma is not None:
            inputs.append(helper.make_tensor_value_info("sigma", TensorProto.FLOAT, sigma))
        graph = helper.make_graph(
            [helper.make_node(*node[:3], **(node[3] if len(node) > 3 else {})) for node in nodes],
            "small",
            inputs,
            [helper.make_tensor_value_info("denoised", TensorProto.FLOAT, out)],
            list(constants),
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)])
        model.ir_version = 8
        save(model, tmp_path / "small.onnx")
        return tmp_path / "small.onnx"

    return make

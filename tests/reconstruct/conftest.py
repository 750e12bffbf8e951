"""Small ONNX models of any signature, written in the tests, and a small shot of smooth views."""

import numpy as np
import pytest
from onnx import TensorProto, helper, save
from scipy.ndimage import gaussian_filter

from gs2ci.core.records import Shot, Truth


@pytest.fixture(scope="session")
def smooth_shot():
    """Four views of 32 × 40 pixels behind masks that open four elements in ten."""
    rng = np.random.default_rng(0)
    picture = gaussian_filter(rng.random((32, 40, 3)), (3, 3, 0))
    picture = 0.2 + 0.6 * (picture - picture.min()) / np.ptp(picture)
    views = np.stack([np.roll(picture, step, axis=1) for step in range(4)]).astype(np.float32)
    masks = (rng.random((4, 32, 40)) < 0.4).astype(np.float32)
    measurement = (masks[..., None] * views).sum(axis=0)
    return Shot(measurement=measurement, masks=masks, weights=np.ones(4, np.float32), truth=Truth(views)).check()


@pytest.fixture
def write_model(tmp_path):
    """Write a model; inputs, outputs: (name, shape[, kind]); nodes: (operator, inputs, outputs[, attributes])."""

    def value(name, shape, kind=TensorProto.FLOAT):
        return helper.make_tensor_value_info(name, kind, shape)

    def write(nodes, inputs, outputs, constants=(), *, opset=17, name="small.onnx"):
        graph = helper.make_graph(
            [helper.make_node(*node[:3], **(node[3] if len(node) > 3 else {})) for node in nodes],
            "small",
            [value(*one) for one in inputs],
            [value(*one) for one in outputs],
            list(constants),
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)])
        model.ir_version = 8
        save(model, tmp_path / name)
        return tmp_path / name

    return write

"""Small ONNX denoisers."""

import pytest
from onnx import TensorProto, helper, save


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

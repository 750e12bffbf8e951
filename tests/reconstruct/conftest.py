"""Small ONNX models of any signature, written in the tests."""

import pytest
from onnx import TensorProto, helper, save


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

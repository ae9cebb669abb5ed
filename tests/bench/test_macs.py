import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from vwnav.bench.features.macs import GraphCost, graph_cost


def weight(name: str, *shape: int) -> onnx.TensorProto:
    return numpy_helper.from_array(np.ones(shape, np.float32), name)


def graph(nodes: list[onnx.NodeProto], weights: list[onnx.TensorProto]) -> bytes:
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 1, "h", "w"])
    result = helper.make_tensor_value_info("result", TensorProto.FLOAT, None)
    whole = helper.make_graph(nodes, "by_hand", [image], [result], weights)
    model = helper.make_model(whole, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    return model.SerializeToString()


def convolution(*inputs: str, output: str, stride: int = 1, groups: int = 1) -> onnx.NodeProto:
    return helper.make_node(
        "Conv", inputs, [output], strides=[stride] * 2, pads=[1] * 4, group=groups
    )


def test_convolutions_are_counted_as_by_hand():
    # 640 x 480 -> 4 channels at half of it by 3 x 3 x 1; then 3 x 3, each channel on its own.
    nodes = [
        convolution("image", "a", "b", output="x", stride=2),
        convolution("x", "c", output="result", groups=4),
    ]
    cost = graph_cost(
        graph(nodes, [weight("a", 4, 1, 3, 3), weight("b", 4), weight("c", 4, 1, 3, 3)])
    )
    pixels = 320 * 240
    assert cost == GraphCost(parameters=36 + 4 + 36, macs=pixels * 4 * 9 + pixels * 4 * 9)


def test_a_matrix_product_costs_rows_times_columns_times_depth():
    nodes = [helper.make_node("MatMul", ["image", "a"], ["result"])]
    cost = graph_cost(graph(nodes, [weight("a", 640, 7)]))
    assert cost == GraphCost(parameters=640 * 7, macs=480 * 7 * 640)


def test_a_quantised_weight_counts_as_the_float_one():
    packed = numpy_helper.from_array(np.ones((4, 1, 3, 3), np.int8), "a8")
    nodes = [
        helper.make_node("DequantizeLinear", ["a8", "scale"], ["a"]),
        convolution("image", "a", output="result"),
    ]
    cost = graph_cost(graph(nodes, [packed, numpy_helper.from_array(np.float32(0.1), "scale")]))
    assert cost == GraphCost(parameters=36, macs=640 * 480 * 36)


def test_without_the_onnx_package_one_line_says_what_to_install(monkeypatch):
    from vwnav.errors import ConfigError

    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    with pytest.raises(ConfigError, match=r"pip install .*\[bench\]'"):
        graph_cost(b"")

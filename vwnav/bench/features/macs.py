"""What a network costs: its parameters and multiply-accumulate operations, from the ONNX graph."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vwnav.errors import ConfigError
from vwnav.machine.extras import how_to_install

if TYPE_CHECKING:
    import onnx

SIZE_WH = (640, 480)  # the image that operations are counted for, unless another is named
_COUNTED = ("Conv", "Gemm", "MatMul")
_FLOAT = 1  # onnx.TensorProto.FLOAT


@dataclass(frozen=True, slots=True)
class GraphCost:
    """Attributes: numbers of learned values, and of multiply-accumulates on an image."""

    parameters: int
    macs: int


def graph_cost(graph: bytes, size_wh: tuple[int, int] = SIZE_WH) -> GraphCost:
    """Count convolutions and matrix products; everything else is not worth the mention.

    Shapes are those of a real run, so whatever the exporter left dynamic is known.

    Raises:
        ConfigError: the onnx package is not installed.
    """
    try:
        import onnx
    except ImportError as error:
        raise ConfigError(
            f"parameters and MACs are not counted: {how_to_install('bench')}"
        ) from error
    model = onnx.load_from_string(graph)
    nodes = [node for node in model.graph.node if node.op_type in _COUNTED]
    weights = {value.name: tuple(value.dims) for value in model.graph.initializer}
    made_by = {name: node for node in model.graph.node for name in node.output}

    def stored(name: str) -> tuple[int, ...] | None:
        """The shape of a weight, also behind the nodes that unpack a quantised one."""
        while name not in weights and name in made_by and made_by[name].op_type.endswith("Linear"):
            name = made_by[name].input[0]
        return weights.get(name)

    wanted = [name for node in nodes for name in (*node.input[:2], *node.output)]
    shapes = _measured(model, [name for name in wanted if stored(name) is None], size_wh)
    shapes |= {name: shape for name in wanted if (shape := stored(name)) is not None}
    parameters = {name: stored(name) for node in nodes for name in node.input[1:]}
    return GraphCost(
        sum(int(np.prod(shape)) for shape in parameters.values() if shape is not None),
        sum(_macs(node, shapes) for node in nodes),
    )


def _measured(
    model: "onnx.ModelProto", names: list[str], size_wh: tuple[int, int]
) -> dict[str, tuple[int, ...]]:
    """Shapes of intermediate values, from one run."""
    import onnx
    import onnxruntime

    probed = onnx.ModelProto()
    probed.CopyFrom(model)
    inputs = {value.name for value in model.graph.input}
    values = sorted(set(names) - inputs)
    present = {value.name for value in model.graph.output}
    probed.graph.output.extend(
        onnx.helper.make_tensor_value_info(name, _FLOAT, None)
        for name in values
        if name not in present
    )
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    session = onnxruntime.InferenceSession(
        probed.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    feed = _feed(session, size_wh)
    results = dict(zip(values, session.run(values, feed), strict=True)) | feed
    return {name: result.shape for name, result in results.items()}


def _feed(session: Any, size_wh: tuple[int, int]) -> dict[str, Any]:
    """An image of noise for the 4-D input, and a budget for the other."""
    w, h = size_wh
    noise = np.random.default_rng(0).integers(0, 255, (1, 1, h, w))
    return {
        value.name: noise.astype(np.uint8 if "uint8" in value.type else np.float32)
        if len(value.shape) == 4
        else np.array([1000], np.int64)
        for value in session.get_inputs()
    }


def _macs(node: "onnx.NodeProto", shapes: dict[str, tuple[int, ...]]) -> int:
    """Each output value of a convolution or product costs one operation per weight it reads."""
    outputs = int(np.prod(shapes[node.output[0]]))
    if node.op_type == "Conv":
        return outputs * int(np.prod(shapes[node.input[1]][1:]))  # (out, in / groups, kh, kw)
    transposed = any(each.name == "transA" and each.i for each in node.attribute)
    return outputs * shapes[node.input[0]][-2 if transposed else -1]

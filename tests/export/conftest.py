import onnx
import pytest
import torch

from export import export_onnx
from models.network import NETWORK_SIZES, FeatureNetwork


@pytest.fixture(scope="session")
def network():
    """An untrained nano network whose batch norms have seen something."""
    torch.manual_seed(3)
    network = FeatureNetwork(NETWORK_SIZES["nano"])
    with torch.no_grad():
        network(255 * torch.rand(4, 1, 64, 64))
    return network.eval()


@pytest.fixture(scope="session")
def model(network) -> onnx.ModelProto:
    return export_onnx.to_onnx(network)


@pytest.fixture(scope="session")
def checkpoint(network, tmp_path_factory):
    """A checkpoint as train.py writes it, less what the export does not read."""
    path = tmp_path_factory.mktemp("checkpoint") / "last.pt"
    average = {f"module.{name}": value for name, value in network.state_dict().items()}
    config = {"data": "/home/somebody/data", "network": vars_of(network.config)}
    torch.save({"config": config, "step": 7, "average": average, "optimizer": {}}, path)
    return path


def vars_of(config) -> dict:
    return {name: getattr(config, name) for name in config.__dataclass_fields__}

from dataclasses import replace

import pytest
import torch

from models.network import NETWORK_SIZES, FeatureNetwork, NetworkConfig
from training.thin import Responses, main, thin_blocks, thinned

SMALL = NetworkConfig(stem_channels=8, channels=16, keypoint_channels=16, score_channels=8)


@pytest.fixture
def images() -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(2)
    return [255 * torch.rand(1, 1, 64, 96, generator=generator) for _ in range(3)]


@pytest.fixture
def whole(images) -> FeatureNetwork:
    """Random weights with the statistics of real responses."""
    torch.manual_seed(1)
    network = FeatureNetwork(SMALL).train()
    with torch.no_grad():
        for _ in range(30):
            network(torch.cat(images))
    return network.eval()


def difference(whole, thin, image) -> float:
    with torch.inference_mode():
        a, b = whole.eval()(image).descriptors, thin.eval()(image).descriptors
    return float((a - b).norm() / a.norm())


def test_at_full_rank_nothing_changes(whole, images):
    config = replace(SMALL, stem_rank=8, rank=16, coarse_rank=16)
    thin = thinned(whole, config, images)
    assert len(list(thin_blocks(thin))) == 9
    assert difference(whole, thin, images[0]) < 1e-4


def test_at_half_of_the_rank_the_strongest_directions_stay(whole, images):
    config = replace(SMALL, stem_rank=4, rank=8, coarse_rank=8)
    torch.manual_seed(5)
    anew = FeatureNetwork(config)
    anew.load_state_dict(
        anew.state_dict() | {"descriptors.weight": whole.state_dict()["descriptors.weight"]}
    )
    near = difference(whole, thinned(whole, config, images), images[0])
    assert near < 0.7 * difference(whole, anew, images[0])


def test_directions_are_those_of_the_responses():
    responses, generator = Responses(3), torch.Generator().manual_seed(0)
    along = torch.tensor([0.6, 0.8, 0.0])
    values = torch.randn(4000, generator=generator)[:, None] * along + 5.0
    responses.add(torch.nn.Identity(), (), values.T[None, :, :, None])
    directions, kept = responses.directions(1)
    assert kept == pytest.approx(1.0)
    assert abs(directions[:, 0] @ along.double()).item() == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("size", "said"),
    [("default", "no whole convolutions of the size"), ("nano", "no readable pictures")],
)
def test_what_cannot_be_made_thin_is_one_line(size, said, tmp_path):
    (tmp_path / "train").mkdir()
    config = replace(NETWORK_SIZES["nano"], stem_rank=0, rank=0, coarse_rank=0)
    average = {f"module.{name}": v for name, v in FeatureNetwork(config).state_dict().items()}
    fields = {name: getattr(config, name) for name in config.__dataclass_fields__}
    weights = tmp_path / "whole.ckpt"
    torch.save({"config": {"network": fields}, "average": average}, weights)
    words = ["--size", size, "--data", str(tmp_path), "-o", str(tmp_path / "thin.ckpt")]
    with pytest.raises(SystemExit, match=said):
        main([str(weights), *words])
    assert not (tmp_path / "thin.ckpt").exists()


def test_the_weights_that_are_read_are_not_written_over(tmp_path):
    (tmp_path / "train").mkdir()
    weights = tmp_path / "whole.ckpt"
    weights.write_bytes(b"weights")
    with pytest.raises(SystemExit, match="is what is read"):
        main([str(weights), "--data", str(tmp_path), "-o", str(weights)])
    assert weights.read_bytes() == b"weights"

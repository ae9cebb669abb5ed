from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from models.network import (
    NETWORK_SIZES,
    FeatureNetwork,
    NetworkConfig,
    normalise_contrast,
    sample_descriptors,
)


@pytest.mark.parametrize("size", list(NETWORK_SIZES))
@pytest.mark.parametrize("height_width", [(32, 64), (96, 160), (256, 448)])
def test_every_cell_gets_a_descriptor_64_logits_and_a_score(size, height_width):
    config = NETWORK_SIZES[size]
    height, width = height_width
    with torch.inference_mode():
        dense = FeatureNetwork(config).eval()(torch.rand(2, 1, height, width) * 255)
    cells = (height // 8, width // 8)
    assert dense.descriptors.shape == (2, config.descriptor_dim, *cells)
    assert dense.peak_logits.shape == (2, 64, *cells)
    assert dense.score_logits.shape == (2, 1, *cells)


@pytest.mark.parametrize(("size", "most"), [("nano", 80_000), ("default", 420_000)])
def test_the_networks_stay_small(size, most):
    network = FeatureNetwork(NETWORK_SIZES[size])
    assert sum(p.numel() for p in network.parameters()) < most


def released(name: str) -> dict:
    models = Path(__file__).resolve().parents[2] / "models"
    return torch.load(models / f"vwnav_{name}.ckpt", map_location="cpu", weights_only=True)


@pytest.mark.parametrize("name", ["default", "default_open", "nano"])
def test_weights_of_the_first_generation_still_fit(name):
    state = released(name)
    network = FeatureNetwork(NetworkConfig(**state["config"]["network"]))
    average = {k.removeprefix("module."): v for k, v in state["average"].items()}
    network.load_state_dict({k: v for k, v in average.items() if k != "n_averaged"})


def test_the_score_reads_descriptors_and_keypoints_side_by_side():
    torch.manual_seed(0)
    network = FeatureNetwork(NETWORK_SIZES["nano"]).eval()
    fused, peaks = torch.randn(1, 48, 4, 6), torch.randn(1, 64, 4, 6)
    with torch.inference_mode():
        expected = network.score(torch.cat([fused, peaks], dim=1))
        torch.testing.assert_close(network.judge(fused, peaks), expected)


@settings(max_examples=10, deadline=None)
@given(gain=st.floats(0.5, 1.5), offset=st.floats(-60, 60))
def test_brightness_and_contrast_hardly_change_what_the_network_sees(gain, offset):
    image = 128 + 40 * torch.randn(1, 1, 96, 96, generator=torch.Generator().manual_seed(3))
    changed = gain * image + offset
    difference = normalise_contrast(changed) - normalise_contrast(image)
    assert difference.abs().mean() < 0.05


def test_a_flat_image_is_seen_as_nothing_not_as_noise():
    assert normalise_contrast(torch.full((1, 1, 64, 64), 200.0)).abs().max() < 1e-3


def test_the_descriptor_of_cell_zero_sits_at_pixel_three_and_a_half():
    descriptors = torch.randn(1, 64, 4, 6, generator=torch.Generator().manual_seed(0))
    uv = torch.tensor([[[3.5, 3.5], [3.5 + 8 * 5, 3.5 + 8 * 2]]])
    sampled = sample_descriptors(descriptors, uv)[0]
    expected = torch.nn.functional.normalize(
        torch.stack([descriptors[0, :, 0, 0], descriptors[0, :, 2, 5]]), dim=-1
    )
    torch.testing.assert_close(sampled, expected)


def test_between_two_cells_descriptors_are_mixed_by_distance():
    descriptors = torch.zeros(1, 2, 1, 2)
    descriptors[0, 0, 0, 0] = 1.0  # left cell says (1, 0)
    descriptors[0, 1, 0, 1] = 1.0  # right cell says (0, 1)
    sampled = sample_descriptors(descriptors, torch.tensor([[[3.5 + 2.0, 3.5]]]))[0, 0]
    assert (sampled[0] / sampled[1]).item() == pytest.approx(3.0)  # 6 px from one, 2 from the other

import numpy as np
import pytest
import torch

from export.parity import drawn_images
from models.extractor import BORDER_PX, Extractor, cell_peaks
from models.network import FeatureNetwork, NetworkConfig


@pytest.fixture(scope="module")
def extractor():
    torch.manual_seed(7)
    return Extractor(FeatureNetwork(NetworkConfig()).eval())


def extract(extractor, image, max_keypoints):
    with torch.inference_mode():
        outputs = extractor(torch.from_numpy(image)[None, None], torch.tensor([max_keypoints]))
    return [x.numpy() for x in outputs]


@pytest.mark.parametrize("max_keypoints", [1, 100, 5000])
def test_never_more_keypoints_than_asked_for_and_the_best_first(extractor, max_keypoints):
    uv, scores, descriptors = extract(extractor, drawn_images(1)[0], max_keypoints)
    assert 0 < len(uv) <= max_keypoints
    assert len(uv) == len(scores) == len(descriptors)
    assert (np.diff(scores) <= 0).all()
    assert np.linalg.norm(descriptors, axis=1) == pytest.approx(1.0, abs=1e-5)


def test_keypoints_keep_away_from_the_border_and_from_each_other(extractor):
    image = drawn_images(1)[0]
    uv, _, _ = extract(extractor, image, 5000)
    limit = np.array(image.shape[::-1]) - 1 - BORDER_PX
    assert (uv > BORDER_PX - 1).all()
    assert (uv < limit + 1).all()
    distance = np.abs(uv[:, None] - uv[None]).max(axis=2) + 99 * np.eye(len(uv))
    assert distance.min() > 1.0


def test_a_scene_moved_by_whole_cells_moves_its_features_exactly(extractor):
    scene = np.random.default_rng(1).integers(0, 255, (192, 192)).astype(np.uint8)
    found = []
    for shift in (0, 32):
        image = np.full((544, 544), 90, np.uint8)
        image[160 + shift : 352 + shift, 160:352] = scene
        uv, _, descriptors = extract(extractor, image, 3000)
        inside = (np.abs(uv - [255.5, 255.5 + shift]) < 96).all(axis=1)
        found.append((uv[inside] - [0, shift], descriptors[inside]))
    (uv0, descriptors0), (uv1, descriptors1) = found
    assert len(uv0) == len(uv1) > 50
    same = np.linalg.norm(uv0[:, None] - uv1[None], axis=2).argmin(axis=1)
    uv1, descriptors1 = uv1[same], descriptors1[same]
    np.testing.assert_allclose(uv0, uv1, atol=1e-3)
    np.testing.assert_allclose(descriptors0, descriptors1, atol=1e-4)


def test_sub_pixel_positions_are_read_back_from_the_logits():
    # The logits of Gaussian bumps; one of them near the border of its cell.
    true_uv = torch.tensor([[11.5, 12.25], [28.0, 19.75], [35.3, 31.6]])
    v, u = torch.meshgrid(torch.arange(48.0), torch.arange(48.0), indexing="ij")
    distance2 = (u - true_uv[:, 0, None, None]) ** 2 + (v - true_uv[:, 1, None, None]) ** 2
    surface = -0.5 * distance2.amin(dim=0) / 0.7**2
    cells = torch.nn.functional.pixel_unshuffle(surface[None, None], 8)
    uv, keep = cell_peaks(cells)
    kept = uv[0][keep[0] > 0]
    nearest = (kept[None] - true_uv[:, None]).norm(dim=-1).amin(dim=1)
    assert nearest.max() < 0.05


def test_refinement_can_be_trained():
    logits = torch.randn(1, 64, 4, 4, requires_grad=True)
    uv, _ = cell_peaks(logits)
    uv.sum().backward()
    assert logits.grad is not None
    assert logits.grad.abs().sum() > 0

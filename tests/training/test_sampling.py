import numpy as np
import pytest
import torch

from training import warps
from training.data import scene
from training.photometric import PhotometricConfig
from training.sampling import SampleConfig, ViewPairs, draw_views, parabola_vertices, whole_cells

NO_CHANGE = PhotometricConfig(**dict.fromkeys(PhotometricConfig.__dataclass_fields__, 0.0))


def test_a_sample_depends_on_seed_and_number_alone(drawn_scenes):
    samples = [ViewPairs(drawn_scenes, SampleConfig(), seed=5)[11] for _ in range(2)]
    other = ViewPairs(drawn_scenes, SampleConfig(), seed=6)[11]
    assert all(torch.equal(samples[0][name], samples[1][name]) for name in samples[0])
    assert not torch.equal(samples[0]["image0"], other["image0"])


@pytest.mark.parametrize("relief_share", [0.0, 1.0])
def test_both_views_look_alike_at_corresponding_points(relief_share, drawn_scenes):
    config = SampleConfig(photo=NO_CHANGE, relief_share=relief_share)
    pairs = ViewPairs(drawn_scenes, config, seed=1)
    differences = []
    for index in range(6):
        sample = pairs[index]
        uv = [sample[f"uv{k}"].round().long().clamp(0, 223) for k in (0, 1)]
        grey = [sample[f"image{k}"][0][uv[k][:, 1], uv[k][:, 0]].float() for k in (0, 1)]
        differences.append((grey[0] - grey[1]).abs())
    assert torch.cat(differences).median() < 12  # noise of the drawn images is 6 of 255


def test_corners_are_carried_by_the_homography(drawn_scenes):
    sample = ViewPairs(drawn_scenes, SampleConfig(relief_share=0.0), seed=2)[3]
    present = sample["present"] > 0
    carried = warps.warp_points(sample["H_1_0"].numpy(), sample["corners0"][present].numpy())
    assert present.sum() > 20
    np.testing.assert_allclose(carried, sample["corners1"][present].numpy(), atol=0.01)


def test_black_corners_of_a_registered_image_count_as_unseen():
    image = np.random.default_rng(0).integers(50, 200, (300, 300, 3)).astype(np.uint8)
    image[:, :150] = 0
    pair = scene("pair", "drawn", [image, image])
    views = draw_views(pair, np.random.default_rng(0), SampleConfig())
    dark = views.views[0].max(axis=2) == 0
    assert dark.any()
    assert not views.seen_by_both[0][dark].any()


def test_blank_pairs_are_refused_with_a_word():
    blank = scene("pair", "drawn", [np.zeros((300, 300, 3), np.uint8)] * 2)
    with pytest.raises(RuntimeError, match="blank"):
        ViewPairs([blank], SampleConfig(), seed=0)[0]


def test_a_parabola_is_read_at_its_vertex():
    v, u = np.mgrid[0:9, 0:9].astype(float)
    surface = 5 - (u - 4.3) ** 2 - 2 * (v - 3.8) ** 2
    vertex = parabola_vertices(surface, np.array([4]), np.array([4]))
    np.testing.assert_allclose(vertex, [[4.3, 3.8]], atol=1e-6)


def test_a_cell_with_one_unseen_pixel_is_not_whole():
    mask = np.full((16, 16), 255, np.uint8)
    mask[3, 9] = 0
    assert whole_cells(mask).tolist() == [[1, 0], [1, 1]]


def test_groups_that_are_absent_leave_their_share_to_the_others(drawn_scenes):
    assert len(ViewPairs(drawn_scenes, SampleConfig(), seed=0)[0]["uv0"]) == 256

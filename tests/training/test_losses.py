import numpy as np
import pytest
import scipy.linalg
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional as F

from training import losses, warps

IDENTITY = torch.eye(3)[None]


def plane(H_1_0=IDENTITY, size_px=64):
    """Ground without relief."""
    return losses.Ground(H_1_0, torch.zeros(len(H_1_0), 2, size_px // 4, size_px // 4))


def carry(H_1_0, uv0):
    return losses.carry(plane(H_1_0), uv0, 64)


def match(descriptors1, uv=None, cells=None):
    """log p of orthogonal descriptors against `descriptors1`, the points 20 px apart."""
    count = descriptors1.shape[1]
    spread = torch.stack([20.0 * torch.arange(count), torch.zeros(count)], dim=-1)[None]
    uv = spread if uv is None else uv
    nothing = torch.zeros(1, count, 1, 1)
    nothing[0, 0] = -1.0  # a cell that resembles no point
    return losses.match_log_probability(
        [torch.eye(count)[None], descriptors1],
        [uv, uv],
        [nothing, nothing if cells is None else cells],
        rivals=1.0,
        temperature=0.07,
        near_px=6.0,
    )


def test_perfect_descriptors_match_surely():
    assert match(torch.eye(8)[None]).exp().min() > 0.99


def test_swapped_descriptors_do_not_match():
    log_p = match(torch.eye(4)[None][:, [1, 0, 2, 3]])
    assert (log_p.exp() > 0.9).tolist() == [[False, False, True, True]]


def test_a_cell_elsewhere_with_the_same_descriptor_is_a_rival_and_one_nearby_is_not():
    twin = F.one_hot(torch.tensor(2), 4).float().view(1, 4, 1, 1)
    there = torch.tensor([[[100.0, 0.0], [120.0, 0.0], [50.0, 0.0], [160.0, 0.0]]])
    here = there.clone()
    here[0, 2] = torch.tensor([3.0, 3.0])  # the cell's centre is (3.5, 3.5)
    far, near = (match(torch.eye(4)[None], uv, twin)[0].exp() for uv in (there, here))
    # one of two directions has one equal rival
    assert far[2] == pytest.approx(0.5**0.5, abs=0.01)
    assert near[2] > 0.99
    assert far[[0, 1, 3]].min() > 0.99


def test_without_robustness_the_loss_is_cross_entropy():
    log_p = torch.log(torch.tensor([[0.9, 0.5, 0.01]]))
    loss = losses.robust_loss(log_p, torch.zeros(1))
    assert loss.item() == pytest.approx(-log_p.mean().item(), rel=1e-2)


def test_robustness_weakens_the_pull_of_a_label_the_network_is_sure_against():
    log_p = torch.log(torch.tensor([[1e-4]])).requires_grad_()
    pulls = []
    for q in (0.0, 0.5):
        (pull,) = torch.autograd.grad(losses.robust_loss(log_p, torch.tensor([q])), log_p)
        pulls.append(abs(pull.item()))
    assert pulls[1] < 0.02 * pulls[0]


def surface_with_peak(u, v, size=64):
    surface = torch.zeros(1, 1, size, size)
    surface[0, 0, v, u] = 30.0
    return surface


def agreement(surface0, surface1, H_1_0=IDENTITY, sigma_px=1.0):
    centre = torch.tensor([[[30.0, 30.0]]])
    log_p = losses.agreement_log_probability(
        [surface0, surface1], centre, plane(H_1_0), torch.tensor([sigma_px])
    )
    return log_p.exp().item()


@settings(max_examples=20, deadline=None)
@given(st.integers(26, 34), st.integers(26, 34), st.integers(-9, 9), st.integers(-9, 9))
def test_peaks_at_the_same_place_of_the_ground_agree(u, v, du, dv):
    H_1_0 = torch.from_numpy(warps.translation(du, dv)).float()[None]
    assert agreement(
        surface_with_peak(u, v), surface_with_peak(u + du, v + dv), H_1_0
    ) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("off_px", [1, 2, 3])
def test_the_reward_falls_off_as_a_gaussian(off_px):
    reward = agreement(surface_with_peak(30, 30), surface_with_peak(30 + off_px, 30), sigma_px=1.5)
    assert reward == pytest.approx(np.exp(-0.5 * (off_px / 1.5) ** 2), rel=1e-3)


def test_flat_surfaces_earn_little():
    flat = torch.zeros(1, 1, 64, 64)
    assert agreement(flat, flat) < 0.05


def test_what_only_one_image_shows_is_left_out_of_the_window():
    # The window leaves image 1 to the right; the peak outside of it earns nothing.
    H_1_0 = torch.from_numpy(warps.translation(31.0, 0.0)).float()[None]
    reward = agreement(surface_with_peak(35, 30), torch.zeros(1, 1, 64, 64), H_1_0)
    assert reward < 0.05


def test_the_corner_loss_asks_for_the_right_pixel():
    logits = torch.zeros(1, 64, 4, 4)
    corners = torch.tensor([[[9.2, 17.9], [-100.0, -100.0]]])  # cell (1, 2), pixel (1, 2)
    present = torch.tensor([[1.0, 0.0]])
    assert losses.corner_loss(logits, corners, present).item() == pytest.approx(np.log(64))
    logits[0, 2 * 8 + 1, 2, 1] = 20.0
    assert losses.corner_loss(logits, corners, present).item() < 1e-3


def test_keypoints_meet_where_the_homography_carries_them():
    H_1_0 = torch.from_numpy(warps.translation(5.0, 3.0)).float()[None]
    uv0 = torch.tensor([[[10.0, 10.0], [40.0, 40.0], [60.0, 5.0]]])
    uv1 = torch.tensor([[[45.5, 43.0], [15.0, 13.0], [65.0, 8.0]]])
    seen = [torch.tensor([[1.0, 1.0, 0.0]]), torch.ones(1, 3)]
    meeting = losses.meet([uv0, uv1], carry(H_1_0, uv0), seen)
    assert meeting.partner[0, :2].tolist() == [1, 0]
    assert meeting.mutual.tolist() == [[True, True, False]]
    torch.testing.assert_close(meeting.distance_px[0, :2], torch.tensor([0.0, 0.5]))


def test_the_reprojection_loss_pulls_partners_together():
    uv0 = torch.tensor([[[10.0, 10.0]]], requires_grad=True)
    uv1 = torch.tensor([[[11.0, 10.0]]], requires_grad=True)
    carried0 = carry(IDENTITY, uv0)
    meeting = losses.meet([uv0, uv1], carried0, [torch.ones(1, 1)] * 2)
    loss = losses.reprojection_loss(carried0, uv1, meeting, torch.ones(1, 1))
    loss.backward()
    assert loss.item() == pytest.approx(1.0, abs=0.01)
    assert uv0.grad[0, 0, 0] < 0 < uv1.grad[0, 0, 0]


def test_a_right_match_is_the_mutual_neighbour_at_the_right_place():
    uv = torch.tensor([[[10.0, 10.0], [40.0, 40.0], [70.0, 70.0]]])
    descriptors = torch.eye(3)[None]
    swapped = descriptors[:, [0, 2, 1]]  # the first is right, the others are each other's
    kept = [torch.ones(1, 3)] * 2
    right = losses.rightly_matched([descriptors, swapped], uv, uv, kept, torch.ones(1))
    assert right[0].tolist() == right[1].tolist() == [[1.0, 0.0, 0.0]]


def test_dropped_keypoints_match_nothing():
    uv = torch.tensor([[[10.0, 10.0], [40.0, 40.0]]])
    kept = [torch.tensor([[1.0, 0.0]]), torch.ones(1, 2)]
    described = [torch.eye(2)[None]] * 2
    right0, right1 = losses.rightly_matched(described, uv, uv, kept, torch.ones(1))
    assert right0.tolist() == right1.tolist() == [[1.0, 0.0]]


def test_keypoints_without_weight_do_not_count_for_the_score():
    logits = torch.tensor([[8.0, -8.0]])
    loss = losses.score_loss(logits, torch.ones(1, 2), torch.tensor([[1.0, 0.0]]))
    assert loss.item() < 1e-3


def test_carry_agrees_with_the_warps():
    H = warps.random_relative_view(np.random.default_rng(0), warps.WarpConfig(), 64)
    points = np.random.default_rng(1).uniform(0, 64, (10, 2))
    relief = warps.random_relief(np.random.default_rng(2), 64, 3.0)
    ground = losses.Ground(*(torch.from_numpy(x)[None] for x in (H, relief.transpose(2, 0, 1))))
    ground = ground._replace(relief_px=ground.relief_px.double())
    carried = losses.carry(ground, torch.from_numpy(points)[None], 64)[0]
    expected = warps.warp_points(H, points) + warps.relief_at(relief, points[None], 64)[0]
    # remap interpolates in steps of 1/32 of a node
    np.testing.assert_allclose(carried.numpy(), expected, atol=0.1)


def logits_with_peak(u, v, size=64):
    """(1, 64, h, w): every cell draws its first pixel, the one at (u, v) that pixel."""
    surface = torch.zeros(1, 1, size, size)
    surface[:, :, ::8, ::8] = 20.0
    surface[..., v, u] = 60.0
    return F.pixel_unshuffle(surface, 8)


def repeated(logits0, logits1, H_1_0=IDENTITY):
    expected, chance = losses.repeat_probability(
        [logits0, logits1], plane(H_1_0), torch.tensor([1.0])
    )
    return expected.view(8, 8), chance.view(8, 8)


@pytest.mark.parametrize(("off_px", "reward"), [(0, 1.0), (1, 0.607), (3, 0.011)])
def test_a_keypoint_is_repeated_by_one_beside_it(off_px, reward):
    H_1_0 = torch.from_numpy(warps.translation(8.0, 0.0)).float()[None]
    expected, chance = repeated(logits_with_peak(20, 21), logits_with_peak(28 + off_px, 21), H_1_0)
    assert expected[2, 2].item() == pytest.approx(reward, abs=0.01)
    assert chance[2, 2] < 0.15


def test_the_pull_is_towards_what_the_other_view_draws():
    logits0 = torch.zeros(1, 64, 8, 8, requires_grad=True)
    expected, _ = repeated(logits0, logits_with_peak(20, 21))
    expected[2, 2].backward()
    pull = F.pixel_shuffle(logits0.grad, 8)[0, 0]
    assert pull.argmax().item() == 21 * 64 + 20


def test_where_nothing_repeats_nothing_pulls():
    logits0 = logits_with_peak(20, 21).requires_grad_()
    expected, _ = repeated(logits0, logits_with_peak(20, 28))  # seven pixels beside it
    expected[2, 2].backward()
    assert logits0.grad.abs().max() < 1e-3


def test_each_image_is_spread_by_its_own_gaussian():
    density = torch.zeros(2, 1, 16, 16)
    density[:, :, 8, 8] = 1.0
    near = losses.spread(density, torch.tensor([1.0, 2.0]))
    assert near[:, 0, 8, 8].tolist() == [1.0, 1.0]
    at_2_px = near[:, 0, 8, 10]
    np.testing.assert_allclose(at_2_px.numpy(), np.exp([-2.0, -0.5]), rtol=1e-5)


def some_descriptors(dim, seed=0):
    return torch.randn(2, dim, 6, 5, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("dim", [8, 16])
def test_a_student_may_choose_its_axes_and_its_lengths(dim):
    teacher = some_descriptors(dim)
    turn = torch.linalg.qr(torch.randn(dim, dim, generator=torch.Generator().manual_seed(1))).Q
    student = 3.0 * torch.einsum("de,behw->bdhw", turn, teacher)
    assert losses.distillation_loss(student, teacher).item() == pytest.approx(0.0, abs=1e-5)


def test_the_distillation_is_that_of_the_best_turn():
    student, teacher = some_descriptors(8), some_descriptors(8, seed=2)
    own, aim = (
        F.normalize(x, dim=1).transpose(0, 1).flatten(1).T.numpy() for x in (student, teacher)
    )
    turn, _ = scipy.linalg.orthogonal_procrustes(own, aim)
    expected = 1.0 - np.sum((own @ turn) * aim, axis=1).mean()
    assert losses.distillation_loss(student, teacher).item() == pytest.approx(expected, abs=1e-5)


def test_descending_the_distillation_makes_the_student_like_the_teacher():
    teacher = some_descriptors(8)
    student = some_descriptors(8, seed=2).requires_grad_()
    before = losses.distillation_loss(student, teacher)
    for _ in range(50):
        loss = losses.distillation_loss(student, teacher)
        (slope,) = torch.autograd.grad(loss, student)
        student = (student - 20.0 * slope).detach().requires_grad_()
    assert losses.distillation_loss(student, teacher) < 0.3 * before

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from training import losses, warps


def spread_points(count):
    """(1, count, 2) points, all further apart than NEAR_PX."""
    return torch.stack([20.0 * torch.arange(count), torch.zeros(count)], dim=-1)[None]


def test_perfect_descriptors_match_surely():
    descriptors = torch.eye(8)[None]
    log_p, mutual = losses.match_log_probability(descriptors, descriptors, spread_points(8), 0.07)
    assert log_p.exp().min() > 0.99
    assert mutual.all()


def test_swapped_descriptors_do_not_match():
    descriptors = torch.eye(4)[None]
    swapped = descriptors[:, [1, 0, 2, 3]]
    _, mutual = losses.match_log_probability(descriptors, swapped, spread_points(4), 0.07)
    assert mutual.tolist() == [[0, 0, 1, 1]]


def test_a_neighbour_with_the_same_descriptor_is_not_held_against_a_point():
    descriptors = torch.ones(1, 2, 4) / 2
    near = torch.tensor([[[0.0, 0.0], [5.0, 0.0]]])
    log_p_near, _ = losses.match_log_probability(descriptors, descriptors, near, 0.07)
    log_p_far, _ = losses.match_log_probability(descriptors, descriptors, 10 * near, 0.07)
    assert log_p_near.exp().min() > 0.99
    assert log_p_far.exp().max() == pytest.approx(0.5)


def test_without_robustness_the_loss_is_cross_entropy():
    log_p = torch.log(torch.tensor([[0.9, 0.5, 0.01]]))
    loss = losses.matching_loss(log_p, torch.zeros(1))
    assert loss.item() == pytest.approx(-log_p.mean().item(), rel=1e-2)


def test_robustness_weakens_the_pull_of_a_label_the_network_is_sure_against():
    log_p = torch.log(torch.tensor([[1e-4]])).requires_grad_()
    pulls = []
    for q in (0.0, 0.5):
        (pull,) = torch.autograd.grad(losses.matching_loss(log_p, torch.tensor([q])), log_p)
        pulls.append(abs(pull.item()))
    assert pulls[1] < 0.02 * pulls[0]


@settings(max_examples=50, deadline=None)
@given(cell=st.integers(0, 3), u=st.floats(0, 7), v=st.floats(0, 7))
def test_targets_are_distributions_whose_centre_is_the_point(cell, u, v):
    point = torch.tensor([8.0 * cell + u, v])
    targets = losses.keypoint_targets(point[None, None], torch.ones(1, 1), (4, 4))
    torch.testing.assert_close(targets.sum(dim=1), torch.ones(1, 4, 4))
    heat = torch.nn.functional.pixel_shuffle(targets[:, :64], 8)[0, 0]
    rows, columns = torch.meshgrid(torch.arange(32.0), torch.arange(32.0), indexing="ij")
    centre = torch.stack([(heat * columns).sum(), (heat * rows).sum()])
    torch.testing.assert_close(centre, point, atol=1e-3, rtol=0)


def test_absent_points_leave_cells_empty():
    targets = losses.keypoint_targets(torch.full((1, 3, 2), -100.0), torch.zeros(1, 3), (2, 2))
    assert (targets[:, 64] == 1).all()


def test_cells_outside_of_the_other_view_do_not_count():
    logits = torch.randn(1, 65, 2, 2)
    targets = losses.keypoint_targets(torch.tensor([[[4.0, 4.0]]]), torch.ones(1, 1), (2, 2))
    valid = torch.tensor([[[0.0, 1.0], [1.0, 1.0]]])
    expected = -logits.log_softmax(dim=1)[0, 64].flatten()[1:].mean()
    torch.testing.assert_close(losses.keypoint_loss(logits, targets, valid), expected)


def test_reliability_is_asked_for_at_the_point_between_cells():
    cells = torch.tensor([[[[0.0, 1.0]]]])
    sampled = losses.sample_map(cells, torch.tensor([[[3.5, 3.5], [7.5, 3.5], [11.5, 3.5]]]))
    torch.testing.assert_close(sampled, torch.tensor([[0.0, 0.5, 1.0]]))


def test_carry_agrees_with_the_warps():
    H = warps.random_relative_view(np.random.default_rng(0), warps.WarpConfig(), 64)
    points = np.random.default_rng(1).uniform(0, 64, (10, 2))
    carried = losses.carry(torch.from_numpy(H)[None], torch.from_numpy(points)[None])[0]
    np.testing.assert_allclose(carried.numpy(), warps.warp_points(H, points), atol=1e-9)


def peak_logits(uv, cells_hw=(8, 8)):
    targets = losses.keypoint_targets(torch.tensor([uv]), torch.ones(1, len(uv)), cells_hw)
    return (targets + 1e-4).log()


def test_agreed_corners_are_those_that_both_views_have():
    H_1_0 = torch.from_numpy(warps.translation(5.0, 3.0)).float()[None]
    logits0 = peak_logits([[20.0, 20.0], [40.0, 12.0]])
    logits1 = peak_logits([[25.0, 23.0], [13.0, 50.0]])
    uv0, uv1, present = losses.agreed_corners(
        logits0, logits1, H_1_0, torch.ones(1, 8, 8), torch.ones(1, 1)
    )
    assert present.sum() == 1
    torch.testing.assert_close(uv0[0, 0], torch.tensor([20.0, 20.0]), atol=0.1, rtol=0)
    torch.testing.assert_close(uv1[0, 0], torch.tensor([25.0, 23.0]), atol=0.1, rtol=0)

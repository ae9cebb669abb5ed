from dataclasses import replace

import pytest
import torch

from training import ablate
from training.config import PRESETS, changed


@pytest.mark.parametrize("name", list(ablate.ROWS))
def test_each_row_is_a_network_that_runs_and_can_be_trained(name):
    row, config = ablate.ROWS[name], PRESETS["nano"]
    for path, value in row.changes.items():
        config = changed(config, path.split("."), value)
    network = row.build(config.network).train()
    dense = network(255.0 * torch.rand(2, 1, 64, 96))
    assert dense.peak_logits.shape == (2, 64, 8, 12)
    assert dense.descriptors.shape == (2, config.network.descriptor_dim, 8, 12)
    sum(x.square().mean() for x in dense).backward()
    assert network.descriptors.weight.grad.abs().sum() > 0


def test_rows_that_change_nothing_else_than_the_seed_are_there_to_show_chance():
    assert ablate.ROWS["base, other seed"] == replace(ablate.ROWS["base"], changes={"seed": "2"})

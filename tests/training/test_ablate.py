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


def trained_in(tmp_path, monkeypatch, *words):
    monkeypatch.setattr(ablate, "run", lambda name, *_: [name, "7", *["0.5"] * 5])
    ablate.main(["--out", str(tmp_path), *words])


def test_rows_that_are_there_are_not_run_again(tmp_path, monkeypatch, capsys):
    trained_in(tmp_path, monkeypatch, "--only", "base")
    with (tmp_path / "table.csv").open("a") as file:
        file.write("\n")
    trained_in(tmp_path, monkeypatch, "--only", "base", "half the width")
    assert capsys.readouterr().out.count("half the width") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["table.csv"]


@pytest.mark.parametrize("there", [b"", b"\x89PNG\r\n", b"name,value\na,1\n"])
def test_a_table_of_another_kind_is_one_line_and_stays(there, tmp_path, monkeypatch):
    (tmp_path / "table.csv").write_bytes(there)
    with pytest.raises(SystemExit, match="is no table of ablations"):
        trained_in(tmp_path, monkeypatch)
    assert (tmp_path / "table.csv").read_bytes() == there

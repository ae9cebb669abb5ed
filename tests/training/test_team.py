import os
import subprocess
import sys
from itertools import islice

import cv2
import numpy as np
import pytest

from export.parity import drawn_images
from training.data import ROOT
from training.team import Share, Team


def test_the_shares_of_a_batch_are_the_batch():
    shares = [list(islice(Share(3, 8, rank, 2), 8)) for rank in (0, 1)]
    assert sorted(shares[0] + shares[1]) == list(range(24, 40))
    assert shares[1][:4] == [28, 29, 30, 31]


def test_a_batch_that_cannot_be_shared_is_refused(monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "3")
    with pytest.raises(SystemExit, match="8 pairs cannot be shared by 3"):
        Team.join(8)


@pytest.mark.long
def test_two_processes_learn_as_one_does(tmp_path):
    for i, image in enumerate(drawn_images(6)):
        for letter in "ab":
            cv2.imwrite(str(tmp_path / f"{i}_{letter}.jpg"), cv2.resize(image, (300, 300)))
    script = [str(ROOT / "training/train.py"), "--preset", "smoke", "--max-steps", "20"]
    changes = {"minutes": 0, "threads": 1, "loader_processes": 0, "log_every_steps": 5}
    changes |= {"sites": tmp_path, "validation_pairs": 1, "bfloat16": "false"}
    for name, value in changes.items():
        script += ["--set", f"{name}={value}"]
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    curves = []
    for name, start in (("one", []), ("two", launcher)):
        command = [sys.executable, *start, *script, "--out", str(tmp_path / name)]
        environment = os.environ | {"VWNAV_DATA": str(tmp_path), "OMP_NUM_THREADS": "1"}
        done = subprocess.run(command, capture_output=True, text=True, env=environment)
        assert done.returncode == 0, done.stderr
        log = np.genfromtxt(
            tmp_path / name / "log.csv", delimiter=",", names=True, usecols=range(10)
        )
        learned = log["matching"][np.isfinite(log["matching"])]  # rows of a validation have none
        curves.append(learned[:4])
    # The same images in the same order; batch norm looks at half a batch each.
    np.testing.assert_allclose(curves[1], curves[0], rtol=0.1)
    assert curves[1][-1] < curves[1][0]

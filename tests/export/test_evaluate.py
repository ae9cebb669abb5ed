import numpy as np
import pytest

from export import evaluate
from export.parity import drawn_pictures
from training.data import data_folder
from training.validate import finds_its_place, mutual_matches

FOLDER = data_folder()


@pytest.mark.parametrize("rival", [evaluate.turning_sift, evaluate.orb])
def test_a_rival_matches_a_picture_with_itself(rival):
    features = rival(drawn_pictures(1)[0])
    uv0, uv1 = mutual_matches(features, features)
    assert len(uv0) > 50
    assert np.median(np.abs(uv0 - uv1)) == 0


@pytest.mark.parametrize("rival", [evaluate.turning_sift, evaluate.orb])
def test_a_blank_picture_has_no_features_and_no_place(rival):
    features = rival(np.full((64, 64), 90, np.uint8))
    assert not finds_its_place(*mutual_matches(features, features), np.eye(3), 64)


def test_without_data_the_command_says_so(tmp_path, capsys):
    assert evaluate.main(["model.onnx", "--data", str(tmp_path)]) == 1
    assert "VWNAV_DATA" in capsys.readouterr().err


@pytest.mark.skipif(FOLDER is None, reason="no data folder (VWNAV_DATA)")
def test_evaluation_views_are_the_same_every_time_and_share_ground():
    first, again = (evaluate.evaluation_views(FOLDER, 2) for _ in range(2))
    for sample, repeated in zip(first, again, strict=True):
        assert np.array_equal(sample["image0"], repeated["image0"])
        assert sample["valid0"].mean() > 0.4

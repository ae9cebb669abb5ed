import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, numpy_helper

from export import parity, quantize, verify
from export.export_onnx import ExportError
from export.images import read_grey, training_images
from vwnav.vision.features.learned import LearnedFeatures, released_model


@pytest.fixture(scope="module")
def quantised(model) -> onnx.ModelProto:
    return quantize.quantise(model, parity.drawn_images(3))


def run(model, image):
    feed = {"image": image[None, None], "max_keypoints": np.array([300], np.int64)}
    return parity.open_session(model.SerializeToString()).run(None, feed)


def test_int8_finds_nearly_the_same_features(model, quantised):
    image = parity.drawn_images(5, seed=4)[1]
    (uv, _, descriptors), (uv8, _, descriptors8) = run(model, image), run(quantised, image)
    distance = np.linalg.norm(uv8[:, None] - uv[None], axis=2)
    same, nearest = distance.min(axis=1) < 1.0, distance.argmin(axis=1)
    cosine = (descriptors8 * descriptors[nearest]).sum(axis=1)[same]
    assert same.mean() > 0.7
    assert np.median(cosine) > 0.98


def test_the_precisions_of_a_model_are_interchangeable_and_told_apart(model, quantised):
    before, after = ({p.key: p.value for p in each.metadata_props} for each in (model, quantised))
    assert after == before | {"precision": "int8"}


def test_weights_are_a_byte_each_but_for_the_ends_of_the_heads(model, quantised):
    ends = {node.input[1] for node in quantize.last_convolutions(model)}
    convolutions = [node for node in model.graph.node if node.op_type == "Conv"]
    assert 0 < len(ends) < len(convolutions)
    kinds = {w.name: w.data_type for w in quantised.graph.initializer}
    stay = {name for name in kinds if name in {node.input[1] for node in convolutions}}
    assert stay == ends
    assert len(quantised.SerializeToString()) < 0.6 * len(model.SerializeToString())


def test_the_drone_flies_it_like_the_float_one(quantised, tmp_path):
    path = tmp_path / "vwnav_nano_int8.onnx"
    onnx.save(quantised, path)
    found = LearnedFeatures(path).extract(parity.drawn_images(2)[1], 200)
    assert len(found) == 200


@pytest.mark.parametrize("harm", ["missing", "damaged", "quantised already"])
def test_what_cannot_be_quantised_is_refused_with_one_line(harm, quantised, tmp_path, capsys):
    path = tmp_path / "model.onnx"
    if harm == "damaged":
        path.write_bytes(b"not a model")
    elif harm == "quantised already":
        onnx.save(quantised, path)
    arguments = [str(path), "-o", str(tmp_path / "int8.onnx"), "--data", str(tmp_path)]
    assert quantize.main(arguments) == 1
    assert capsys.readouterr().err.strip().count("\n") == 0
    assert not (tmp_path / "int8.onnx").exists()


def test_without_training_images_nothing_is_written(model, tmp_path, capsys):
    path = tmp_path / "model.onnx"
    onnx.save(model, path)
    arguments = [str(path), "-o", str(tmp_path / "int8.onnx"), "--data", str(tmp_path)]
    assert quantize.main(arguments) == 1
    assert "--data" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [("--pictures", "0"), ("-o", "no/int8.onnx"), ("-o", "."), ("-o", "model.onnx")]
)
def test_what_cannot_be_calibrated_or_written_is_one_line(
    words, model, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "train/single/a").mkdir(parents=True)
    cv2.imwrite("train/single/a/0.png", np.full((64, 96), 90, np.uint8))
    onnx.save(model, "model.onnx")
    assert quantize.main(["model.onnx", "-o", "int8.onnx", "--data", ".", *words]) == 1
    assert capsys.readouterr().err.strip().count("\n") == 0
    assert {path.name for path in tmp_path.iterdir()} == {"train", "model.onnx"}


def test_calibration_images_come_from_all_training_sources_and_no_other(tmp_path):
    for place in ("train/single/a", "train/single/b", "train/drone/c", "eval/single/d"):
        (tmp_path / place).mkdir(parents=True)
        for number in range(5):
            image = np.full((70, 100), 20 * number, np.uint8)
            cv2.imwrite(str(tmp_path / place / f"{number}.png"), image)
    chosen = training_images(str(tmp_path), 6)
    assert len(set(chosen)) == 6
    assert {p.parent.name for p in chosen} == {"a", "b", "c"}
    assert read_grey(chosen[0]).shape == (64, 96)


def test_verify_compares_the_precisions_and_says_who_wins(
    model, quantised, checkpoint, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(verify, "REPEATS", 1)
    monkeypatch.setattr(verify, "training_images", lambda *_: [])
    paths = [tmp_path / "float.onnx", tmp_path / "int8.onnx"]
    for each, path in zip((model, quantised), paths, strict=True):
        onnx.save(each, path)
    arguments = [str(paths[0]), str(checkpoint), "--int8", str(paths[1])]
    assert verify.main(arguments) == 0
    printed = capsys.readouterr().out
    assert "% of the inliers" in printed
    assert "FAIL" not in printed


def test_int8_must_be_both_true_and_quick_to_win():
    def compared(inliers, time_ms):
        return verify.verdict([verify.Comparison(inliers=inliers, time_ms=time_ms)])

    assert compared((100, 99), (10.0, 6.0)).endswith("it wins")
    assert "keep float" in compared((100, 90), (10.0, 6.0))
    assert "keep float" in compared((100, 100), (10.0, 9.5))


def test_verify_refuses_a_graph_of_other_weights(checkpoint, model, tmp_path, capsys):
    other = onnx.ModelProto()
    other.CopyFrom(model)
    next(p for p in other.metadata_props if p.key == "feature_set_id").value = "another"
    onnx.save(other, tmp_path / "other.onnx")
    with pytest.raises(ExportError, match="another"):
        verify.verify(tmp_path / "other.onnx", checkpoint, None, [])


@pytest.mark.parametrize("name", ["default_int8", "nano_int8"])
def test_released_weights_take_seven_bits_so_that_no_processor_saturates(name):
    stored = onnx.load(released_model(name)).graph.initializer
    kept = [numpy_helper.to_array(each) for each in stored if each.data_type == TensorProto.INT8]
    largest = max(int(np.abs(each.astype(int)).max()) for each in kept)
    assert 1 < largest <= 64

from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from export import export_onnx, parity
from models.extractor import Extractor
from models.network import NETWORK_SIZES, FeatureNetwork
from tests.quick import first_quick
from vwnav.bench.features.macs import graph_cost

MODELS = Path(__file__).resolve().parents[2] / "models"
RELEASED = sorted(MODELS.glob("vwnav_*.onnx"))
each_release = pytest.mark.parametrize("released", RELEASED, ids=lambda path: path.stem)


def run(session, image, max_keypoints):
    feed = {"image": image[None, None], "max_keypoints": np.array([max_keypoints], np.int64)}
    return session.run(None, feed)


@pytest.mark.parametrize("index", range(5))
def test_the_graph_says_what_pytorch_says_at_every_size(model, network, index):
    session = parity.open_session(model.SerializeToString())
    image = parity.drawn_images(5)[index]
    result = parity.compare(session, Extractor(network), image, max_keypoints=400)
    assert result.ok, result
    assert result.keypoints > 50


def test_the_graph_names_its_features_by_its_weights(model, network):
    metadata = {p.key: p.value for p in model.metadata_props}
    assert metadata["feature_set_id"] == export_onnx.feature_set_id(network)
    assert metadata["feature_set_id"].startswith("vwnav-learned-nano-")
    assert (metadata["model_name"], metadata["descriptor_dim"]) == ("vwnav_nano", "64")


def test_other_weights_have_another_name(network):
    before = export_onnx.feature_set_id(network)
    other = type(network)(network.config)
    assert export_onnx.feature_set_id(other) != before


def test_the_graph_has_no_batch_norm_left_and_no_path_of_the_machine(model):
    assert "BatchNormalization" not in {node.op_type for node in model.graph.node}
    assert str(Path(__file__).resolve().parents[2]).encode() not in model.SerializeToString()


@pytest.mark.parametrize(("size", "most"), first_quick([("nano", 0.25e9), ("default", 1.3e9)]))
def test_an_image_costs_half_of_what_it_did(size, most):
    graph = export_onnx.to_onnx(FeatureNetwork(NETWORK_SIZES[size]).eval())
    assert graph_cost(graph.SerializeToString()).macs <= most


def test_an_export_is_whole_and_can_be_opened(checkpoint, tmp_path, monkeypatch, model):
    monkeypatch.setattr(export_onnx, "to_onnx", lambda _: model)  # tracing again takes long
    output = tmp_path / "model.onnx"
    assert export_onnx.main([str(checkpoint), "-o", str(output)]) == 0
    uv, scores, _ = run(parity.open_session(output), parity.drawn_images(1)[0], 50)
    assert 0 < len(uv) == len(scores) <= 50
    assert [p.name for p in tmp_path.iterdir()] == ["model.onnx"]


def break_bytes(path):
    path.write_bytes(b"not a checkpoint")


def cut_short(path):
    path.write_bytes(path.read_bytes()[:5000])


def diverge(path):
    state = torch.load(path, weights_only=True)
    next(iter(state["average"].values())).fill_(float("nan"))
    torch.save(state, path)


def forget_weights(path):
    state = torch.load(path, weights_only=True)
    state["average"].pop(next(iter(state["average"])))
    torch.save(state, path)


def empty(path):
    path.write_bytes(b"")


@pytest.mark.parametrize(
    "harm",
    [Path.unlink, empty, break_bytes, cut_short, diverge, forget_weights],
    ids=lambda f: f.__name__,
)
def test_a_broken_checkpoint_is_refused_with_one_line(harm, checkpoint, tmp_path, capsys):
    broken, output = tmp_path / "last.pt", tmp_path / "model.onnx"
    broken.write_bytes(checkpoint.read_bytes())
    harm(broken)
    assert export_onnx.main([str(broken), "-o", str(output)]) == 1
    assert capsys.readouterr().err.strip().count("\n") == 0
    assert not output.exists()


@pytest.mark.parametrize(
    "words",
    [
        ("-o", "no/such/model.onnx"),
        ("-o", "."),
        ("-o", "picture.png"),
        ("-o", "m.onnx", "--checkpoint", "no/w.ckpt"),
    ],
)
def test_where_nothing_can_be_written_is_said_before_anything_is_done(
    words, checkpoint, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(export_onnx, "to_onnx", lambda _: pytest.fail("it began to export"))
    assert export_onnx.main([str(checkpoint), *words]) == 1
    assert capsys.readouterr().err.strip().count("\n") == 0
    assert not list(tmp_path.iterdir())


def test_what_is_read_is_not_written_over(checkpoint, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(export_onnx, "to_onnx", lambda _: pytest.fail("it began to export"))
    path = tmp_path / "last.pt"
    path.write_bytes(checkpoint.read_bytes())
    words = [str(path), "-o", str(tmp_path / "m.onnx"), "--checkpoint", str(path)]
    assert export_onnx.main(words) == 1
    assert "is what is read" in capsys.readouterr().err
    assert path.read_bytes() == checkpoint.read_bytes()


def test_weights_without_their_step_can_be_released(checkpoint, tmp_path):
    state = torch.load(checkpoint, weights_only=True)
    torch.save({name: state[name] for name in ("config", "average")}, tmp_path / "lean.ckpt")
    export_onnx.slim_checkpoint(tmp_path / "lean.ckpt", tmp_path / "released.ckpt")
    export_onnx.load_network(tmp_path / "released.ckpt")


def test_a_graph_that_differs_from_pytorch_is_not_written(network, model):
    wrong = onnx.ModelProto()
    wrong.CopyFrom(model)
    # the second: the first only folds pixels, and reads the same backwards
    first = [node for node in wrong.graph.node if node.op_type == "Conv"][1].input[1]
    weight = next(w for w in wrong.graph.initializer if w.name == first)
    values = np.frombuffer(weight.raw_data, np.float32)[::-1]
    weight.raw_data = values.astype(np.float32).tobytes()
    with pytest.raises(export_onnx.ExportError, match="differs from PyTorch"):
        export_onnx.check(wrong, network)


def test_a_released_checkpoint_holds_the_weights_and_no_path_of_here(checkpoint, tmp_path):
    output = tmp_path / "released.ckpt"
    export_onnx.slim_checkpoint(checkpoint, output)
    assert b"/home/somebody" not in output.read_bytes()
    networks = [export_onnx.load_network(path) for path in (checkpoint, output)]
    assert len({export_onnx.feature_set_id(network) for network in networks}) == 1


@each_release
def test_a_released_graph_keeps_the_contract(released):
    session = parity.open_session(released)
    assert session.get_modelmeta().custom_metadata_map["feature_set_id"].startswith("vwnav-learned")
    for height, width in ((256, 448), (480, 640), (32, 32)):
        image = np.random.default_rng(0).integers(0, 255, (height, width)).astype(np.uint8)
        uv, scores, descriptors = run(session, image, 300)
        assert len(uv) <= 300
        assert (np.diff(scores) <= 0).all()
        np.testing.assert_allclose(np.linalg.norm(descriptors, axis=1), 1.0, atol=1e-4)


@each_release
def test_card_and_checkpoint_are_those_of_a_released_graph(released):
    metadata = parity.open_session(released).get_modelmeta().custom_metadata_map
    float_model = released.with_stem(released.stem.removesuffix("_int8"))
    network = export_onnx.load_network(float_model.with_suffix(".ckpt"))
    assert metadata["feature_set_id"] in float_model.with_suffix(".md").read_text()
    assert metadata["feature_set_id"] == export_onnx.feature_set_id(network)

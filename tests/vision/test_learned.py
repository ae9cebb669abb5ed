import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from vision_scenes import texture

from vwnav.errors import ModelError
from vwnav.vision.features.learned import BORDER_PX, LearnedFeatures, released_model

SCENE = texture(5, 300)


@pytest.mark.parametrize(("height", "width"), [(250, 300), (256, 289), (97, 131), (256, 288)])
def test_padding_makes_no_keypoints(learned, height: int, width: int):
    found = learned.extract(np.ascontiguousarray(SCENE[:height, :width]), 3000)
    assert len(found) > 50
    assert found.uv[:, 0].max() < width - BORDER_PX + 0.5
    assert found.uv[:, 1].max() < height - BORDER_PX + 0.5


def test_padding_does_not_change_what_is_far_from_it(learned):
    whole = learned.extract(SCENE[:288, :288].copy(), 2000)
    cut = learned.extract(SCENE[:288, :270].copy(), 2000)
    far = cut.uv[cut.uv[:, 0] < 130]
    apart = np.linalg.norm(far[:, None] - whole.uv[None], axis=2).min(axis=1)
    assert np.mean(apart < 0.5) > 0.9


def test_threads_do_not_change_the_result(learned):
    two = LearnedFeatures(threads=2).extract(SCENE, 200)
    one = learned.extract(SCENE, 200)
    assert np.allclose(one.uv, two.uv, atol=1e-2)


def test_the_released_model_says_which_set_it_makes(learned):
    assert learned.feature_set_id.startswith("vwnav-learned-")
    assert released_model().is_file()


def test_nothing_is_kept_in_this_home_nor_sent_to_the_runtimes_maker(tmp_path: Path):
    program = "from vwnav.vision.features.learned import LearnedFeatures; LearnedFeatures()"
    env = {k: v for k, v in os.environ.items() if k != "ORT_DISABLE_TELEMETRY"}
    env |= {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    subprocess.run([sys.executable, "-c", program], env=env, check=True)
    assert not list(tmp_path.iterdir())


def test_released_weights_are_found_by_name(learned):
    assert LearnedFeatures(Path("default")).feature_set_id == learned.feature_set_id


def test_a_name_that_is_not_released_is_told_what_is(tmp_path: Path):
    with pytest.raises(ModelError, match=r"no model at huge: .* or one of default"):
        LearnedFeatures(Path("huge"))


def test_a_missing_model_is_one_line(tmp_path: Path):
    with pytest.raises(ModelError, match=r"no model at .*none\.onnx"):
        LearnedFeatures(tmp_path / "none.onnx")


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_cut_off_model_is_one_line(tmp_path: Path, share: float):
    data = released_model().read_bytes()
    path = tmp_path / "cut.onnx"
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ModelError, match=r"cut\.onnx") as caught:
        LearnedFeatures(path)
    assert "\n" not in str(caught.value)


def test_noise_in_place_of_a_model_is_one_line(tmp_path: Path):
    path = tmp_path / "noise.onnx"
    path.write_bytes(np.random.default_rng(0).bytes(20_000))
    with pytest.raises(ModelError, match="damaged"):
        LearnedFeatures(path)


def test_a_foreign_model_is_refused(tmp_path: Path):
    onnx = pytest.importorskip("onnx")
    value = onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [1])
    result = onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, [1])
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("Identity", ["x"], ["y"])], "foreign", [value], [result]
    )
    opset = [onnx.helper.make_opsetid("", 18)]
    model = onnx.helper.make_model(graph, opset_imports=opset, ir_version=9)
    path = tmp_path / "foreign.onnx"
    path.write_bytes(model.SerializeToString())
    with pytest.raises(ModelError, match="not one of vwnav"):
        LearnedFeatures(path)

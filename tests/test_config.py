"""Settings: one schema, clear complaints, and a file that reads back as it was."""

import dataclasses
import math
import subprocess
import sys
from pathlib import Path
from typing import Annotated, get_args, get_origin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.config import Config, load_config, save_config, with_features
from vwnav.errors import ConfigError
from vwnav.settings.ranges import Settings, Within

TABLES = {name: type(field.default) for name, field in Config.model_fields.items()}
NUMBERS = [
    (table, field)
    for table, kind in TABLES.items()
    for field in dataclasses.fields(kind)
    if field.type not in (bool, str) and not isinstance(field.default, bool | str)
]
named = pytest.mark.parametrize(
    ("table", "field"), NUMBERS, ids=[f"{table}.{field.name}" for table, field in NUMBERS]
)


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
        ("cruise_m_s = 6.0", "did you mean 'limits.cruise_m_s'"),
        ("[safety]\ncruise_m = 6.0", "did you mean 'limits.cruise_m_s'"),
        ("[ekf]\ngyro_sigma_rad_s = 5.0", "ekf.gyro_sigma_rad_s = 5.0: expected 0 to 3.14159"),
        ("ekf = 3", "ekf = 3: expected a table of settings, \\[ekf\\]"),
        ("[limits]\nclimb_m_s = 'fast'", "limits.climb_m_s"),
        ("[limits]\nclimb_m_s = nan", "limits.climb_m_s"),
        ("[features]\nname = 'surf'", "features.name"),
        ("[features]\nthreads = 0", "features.threads = 0: expected a whole number, 1 to 1024"),
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


# ---- ranges


def bounds_of(field: dataclasses.Field) -> Within:
    assert get_origin(field.type) is Annotated, f"{field.name} says nowhere what makes sense"
    return get_args(field.type)[1]


def refused(tmp_path: Path, table: str, name: str, value: str) -> str:
    """The line that refuses a value as it stands in the file."""
    path = tmp_path / "c.toml"
    path.write_text(f"[{table}]\n{name} = {value}\n")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith(f"settings {path}: {table}.{name} = ")
    assert ": expected " in line
    return line


@named
def test_every_number_says_where_it_makes_sense_and_its_default_is_there(table, field):
    bounds = bounds_of(field)
    assert bounds.lowest < bounds.highest
    default = field.default if isinstance(field.default, tuple) else (field.default,)
    assert all(each in bounds for each in default)


@named
def test_what_is_no_number_or_makes_no_sense_is_refused_in_one_line(tmp_path, table, field):
    bounds = bounds_of(field)
    below = math.nextafter(bounds.lowest, -math.inf) - 1e-9
    senseless = ["nan", "inf", "-inf", "true", "false", "'4'", "[]", "{}"]
    senseless += [repr(below), "-1e-3", repr(bounds.highest * 1.001 + 1.0)]
    for value in senseless + ([repr(bounds.lowest)] if bounds.above else []):
        wanted = {"float": value, "int": value, "tuple": f"[{value}, {value}]"}
        kind = get_args(field.type)[0]
        written = wanted[(get_origin(kind) or kind).__name__]
        line = refused(tmp_path, table, field.name, written)
        assert f"{bounds.highest:g}" in line


def refusal_of(table: str, name: str, value: float) -> str:
    try:
        TABLES[table](**{name: value})
    except ValueError as error:
        return str(error)
    return ""


@named
@given(share=st.floats(0.0, 1.0))
def test_whatever_lies_in_a_range_is_taken(table, field, share):
    """Of one number alone: what goes by another one has rows of its own below."""
    bounds, kind = bounds_of(field), get_args(field.type)[0]
    if kind not in (int, float):
        return
    value = kind(bounds.lowest + share * (bounds.highest - bounds.lowest))
    if value not in bounds:
        return
    refusal = refusal_of(table, field.name, value)
    assert not refusal or "expected at most" in refusal


@pytest.mark.parametrize("table", TABLES)
def test_each_table_refuses_what_is_above_what_it_may_at_most_be(tmp_path, table):
    kind = TABLES[table]
    assert issubclass(kind, Settings)
    for lower, upper in kind.AT_MOST:
        high = next(f for f in dataclasses.fields(kind) if f.name == lower)
        just_above = getattr(kind(), upper) * 1.01
        if just_above in bounds_of(high):
            line = refused(tmp_path, table, lower, repr(just_above))
            assert f"expected at most {upper}" in line


@pytest.mark.parametrize(
    ("table", "line"),
    [
        ("flight", "takeoff_height_m = -4"),
        ("flight", "land_from_m = 0"),
        ("flight", "fixes_to_start = 3.0"),
        ("flight", "ground_station_ids = [255, 0]"),
        ("flight", "ground_station_ids = 255"),
        ("limits", "braking_m_s2 = 9.0"),
        ("safety", "battery_takeoff_ratio = 35"),
        ("safety", "resume_sigma_ratio = 5"),
        ("estimate", "max_jump_m = -1"),
        ("ekf", "mount_sigma_rad = -1"),
        ("ekf", "thrust_aided = 1"),
        ("ekf", "drag_range_per_s = [2.0, 0.02]"),
        ("ekf", "drag_range_per_s = [0.02]"),
        ("recording", "most_gb = -1"),
    ],
)
def test_settings_that_would_not_fly_are_refused(tmp_path, table, line):
    name, value = line.split(" = ")
    refused(tmp_path, table, name, value)


def test_a_command_with_senseless_settings_ends_with_one_line_and_exit_code_1(tmp_path):
    (tmp_path / "c.toml").write_text("[flight]\ntakeoff_height_m = true\n")
    command = [sys.executable, "-m", "vwnav", "fly", "--sim", "--config", tmp_path / "c.toml"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 1
    assert "flight.takeoff_height_m = true: expected 1 to 50" in done.stderr
    assert "Traceback" not in done.stderr


def test_settings_that_an_editor_has_put_a_mark_before_are_read(tmp_path):
    (tmp_path / "c.toml").write_text('[features]\nname = "orb"\n', encoding="utf-8-sig")
    assert load_config(tmp_path / "c.toml").features.name == "orb"


def test_settings_without_end_to_their_nesting_are_refused(tmp_path):
    (tmp_path / "c.toml").write_text("a = " + "[" * 100_000)
    with pytest.raises(ConfigError, match="are not TOML"):
        load_config(tmp_path / "c.toml")

"""What is not installed is installed from the checkout or the wheel: no index has vwnav."""

import shlex
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import pytest

from vwnav import __version__
from vwnav.machine import extras

ROOT = Path(__file__).resolve().parents[2]


def installed_from(monkeypatch, noted):
    found = SimpleNamespace(read_text=lambda _: noted)
    monkeypatch.setattr(metadata, "distribution", lambda _: found)


def test_from_a_checkout_the_checkout_is_named():
    said = extras.how_to_install("maps")
    assert said == f"{sys.executable} -m pip install -e '{ROOT}[maps]'"


@pytest.mark.parametrize(
    ("noted", "wheel"),
    [
        ('{"url": "file:///home/pi/my%20own/vwnav-2.0-x.whl"}', "/home/pi/my own/vwnav-2.0-x.whl"),
        (None, f"vwnav-{__version__}-py3-none-any.whl"),
    ],
)
def test_from_a_wheel_the_wheel_is_named(monkeypatch, tmp_path, noted, wheel):
    installed_from(monkeypatch, noted)
    said = extras.how_to_install("eval", tmp_path)
    assert said == f"{sys.executable} -m pip install '{wheel}[eval]'"


def test_a_python_in_a_folder_with_a_space_can_be_called(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/home/pi/my own/bin/python")
    assert shlex.split(extras.how_to_install("maps"))[0] == sys.executable


def test_nobody_else_words_it_and_every_extra_is_there():
    others = [p.name for p in (ROOT / "vwnav").rglob("*.py") if "pip install" in p.read_text()]
    assert others == ["extras.py"]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(get_args(extras.Extra)) <= set(project["optional-dependencies"])
    assert any(each.startswith("mcap") for each in project["dependencies"])  # reads recordings

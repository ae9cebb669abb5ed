"""What a command needs that is not installed with the program, and how it is installed.

vwnav is on no package index: only its checkout or its wheel knows what an extra takes.
"""

import json
import shlex
import sys
from importlib import metadata
from pathlib import Path
from typing import Literal
from urllib.parse import unquote, urlparse

from vwnav import __version__

Extra = Literal["maps", "eval", "bench"]
_ROOT = Path(__file__).resolve().parents[2]


def how_to_install(extra: Extra, root: Path = _ROOT) -> str:
    """The command line that installs it for the Python that runs.

    Args:
        extra: of `pyproject.toml`.
        root: above the package: a checkout, or where the wheel was unpacked.
    """
    is_checkout = (root / "pyproject.toml").is_file()
    source = f"-e '{root}[{extra}]'" if is_checkout else f"'{_wheel()}[{extra}]'"
    return f"{shlex.quote(sys.executable)} -m pip install {source}"


def _wheel() -> str:
    """The wheel that was installed, as pip has noted it (PEP 610)."""
    try:
        noted = metadata.distribution("vwnav").read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        noted = None
    path = unquote(urlparse(json.loads(noted)["url"]).path) if noted else ""
    return path if path.endswith(".whl") else f"vwnav-{__version__}-py3-none-any.whl"

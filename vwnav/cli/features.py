"""The options that say what looks at pictures, alike in each command that flies or serves one."""

from pathlib import Path
from typing import Annotated

import typer

FeaturesOption = Annotated[
    str | None, typer.Option(help="learned, sift or orb; else as --config says, else learned.")
]
ModelOption = Annotated[
    Path | None, typer.Option(help="Learned features of another size (nano) or ONNX file.")
]
ConfigOption = Annotated[Path | None, typer.Option("--config", help="Settings (TOML).")]

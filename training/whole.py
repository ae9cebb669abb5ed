"""Leaves a file whole or not at all: checkpoints, registrations, exported graphs."""

from pathlib import Path


def write_whole(path: Path, content: bytes) -> None:
    """Write beside a file, and give that its name; whatever ends it leaves nothing half-written.

    Raises:
        OSError: it cannot be written.
    """
    partial = path.with_name(f"{path.name}.partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)

"""Leaves a file whole or not at all: checkpoints, registrations, tables, exported graphs."""

from pathlib import Path


def write_whole(path: Path, content: bytes) -> None:
    """Write beside a file, and give that its name; whatever ends it leaves nothing half-written.

    Raises:
        OSError: it cannot be written; it names `path`.
    """
    partial = path.with_name(f"{path.name}.partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:  # of a full disk the system names no file
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        partial.unlink(missing_ok=True)

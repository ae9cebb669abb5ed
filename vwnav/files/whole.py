"""Writes a file whole or not at all."""

import os
from contextlib import suppress
from pathlib import Path


def write_whole(path: Path, content: str | bytes) -> None:
    """Write to `NAME.part` beside it, and give that its name once its content is on the disk.

    Whatever ends it leaves no `NAME.part`, and a file that was there as it was.

    Raises:
        OSError: it cannot be written; it names `path`.
    """
    data = content.encode() if isinstance(content, str) else content
    partial = path.with_name(f"{path.name}.part")
    try:
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        raise named(error, path) from error
    finally:
        with suppress(OSError):  # of a file system that may only be read it is no news
            partial.unlink(missing_ok=True)


def named(error: OSError, path: Path) -> OSError:
    """The same error with the file's name, which the system leaves out where a write fails."""
    return OSError(error.errno, error.strerror, str(path))

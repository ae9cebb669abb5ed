"""Files that a person put into a folder."""

from collections.abc import Collection
from pathlib import Path

PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp")


def files_in(folder: Path, suffixes: Collection[str]) -> list[Path]:
    """The regular files of a folder with one of these suffixes, in the order of their names.

    Those with a leading dot are left out: they are hidden, and some systems put one beside each
    file that holds no picture (`._a.jpg`).

    Args:
        folder: not looked into deeper.
        suffixes: in small letters; files may have them in capitals.
    """
    return sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and not path.name.startswith(".") and path.is_file()
    )

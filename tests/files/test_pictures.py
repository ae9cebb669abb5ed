"""Pictures that cannot be read are one line, whoever reads them."""

import struct
import zlib
from pathlib import Path

import cv2
import pytest
from PIL import Image, TiffImagePlugin

from vwnav.cameras.image_folder import read_image
from vwnav.errors import MapError, SourceError
from vwnav.maps.build.image_files import corner_images


def huge_picture(path: Path) -> Path:
    """The head of a stitched orthophoto of 1.6 billion pixels."""
    head = b"IHDR" + struct.pack(">IIBBBBB", 40_000, 40_000, 8, 0, 0, 0, 0)
    chunk = struct.pack(">I", len(head) - 4) + head + struct.pack(">I", zlib.crc32(head))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk + b"\0\0\0\x09IDAT" + bytes(100))
    return path


def test_more_pixels_than_are_decoded_is_one_line(tmp_path):
    """OpenCV raises an error of its own there, where it else gives nothing."""
    path = huge_picture(tmp_path / "huge.png")
    with pytest.raises(SourceError, match=r"huge\.png: has more pixels than are decoded"):
        read_image(path)
    table = tmp_path / "map.csv"
    table.write_text("filename,north,west,south,east\nhuge.png,47.1,8.1,47.0,8.2\n")
    with pytest.raises(MapError, match=r"huge\.png: has more pixels than are decoded"):
        corner_images(table)


def test_what_the_decoder_says_of_a_geotiff_is_not_told(tmp_path, capfd):
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[34737] = "WGS 84 / UTM zone 43N|"
    Image.new("L", (8, 8)).save(tmp_path / "a.tif", tiffinfo=tags)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_WARNING)
    assert read_image(tmp_path / "a.tif").shape[:2] == (8, 8)
    data = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "a.tif").write_bytes(data[:-20])
    with pytest.raises(SourceError, match="is not a picture that can be read"):
        read_image(tmp_path / "a.tif")
    assert capfd.readouterr().err == ""

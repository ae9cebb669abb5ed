import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from vwnav.cameras.image_metadata import ImageMetadata, read_image_metadata
from vwnav.errors import SourceError

XMP = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description drone-dji:RelativeAltitude="+40.10"
 drone-dji:GimbalYawDegree="{yaw}" drone-dji:GimbalPitchDegree="{pitch}"
 drone-dji:GimbalRollDegree="{roll}"/></x:xmpmeta>"""


def image(path: Path, *, main=None, exif=None, gps=None, xmp: str = "", size=(160, 120)) -> Path:
    """A JPEG with these tags."""
    tags = Image.Exif()
    for tag, value in (main or {}).items():
        tags[tag] = value
    tags.get_ifd(0x8769).update(exif or {})
    tags.get_ifd(0x8825).update(gps or {})
    gray = Image.fromarray(np.zeros(size[::-1], np.uint8))
    gray.save(path, exif=tags, **({"xmp": xmp.encode()} if xmp else {}))
    return path


def read(path: Path, size=(160, 120)) -> ImageMetadata:
    return read_image_metadata(path, *size)


def gps_tags(lat: float, lon: float, alt_m: float) -> dict[int, object]:
    def dms(angle: float) -> tuple[float, float, float]:
        angle = abs(angle)
        return int(angle), int(angle * 60 % 60), angle * 3600 % 60

    refs = {1: "N" if lat >= 0 else "S", 3: "E" if lon >= 0 else "W"}
    return refs | {2: dms(lat), 4: dms(lon), 5: b"\1" if alt_m < 0 else b"\0", 6: abs(alt_m)}


@given(
    lat=st.floats(-90, 90).filter(lambda x: abs(x) > 1e-3),
    lon=st.floats(-180, 180),
    alt_m=st.floats(-400, 9000),
)
def test_the_position_is_read_back(tmp_path_factory, lat, lon, alt_m):
    path = tmp_path_factory.mktemp("gps") / "a.jpg"
    found = read(image(path, gps=gps_tags(lat, lon, alt_m)))
    assert found.lat_deg == pytest.approx(lat, abs=1e-7)
    assert found.lon_deg == pytest.approx(lon, abs=1e-7)
    assert found.alt_amsl_m == pytest.approx(alt_m, abs=0.01)


def test_an_image_without_metadata_says_nothing(tmp_path: Path):
    Image.fromarray(np.zeros((9, 9), np.uint8)).save(tmp_path / "a.png")
    assert read(tmp_path / "a.png") == ImageMetadata()


def test_a_position_of_zeros_is_none(tmp_path: Path):
    assert read(image(tmp_path / "a.jpg", gps=gps_tags(0.0, 0.0, 0.0))).lat_deg is None


@pytest.mark.parametrize(
    ("yaw", "pitch", "roll", "expected_rpy_deg"),
    [
        ("+42.80", "-90.00", "+0.00", (0.0, 0.0, 42.8)),
        ("-132.0", "-89.00", "0.00", (0.0, 1.0, -132.0)),
        ("10", "-80", "0", (0.0, 10.0, 10.0)),
        ("10", "-90", "+180", (0.0, 0.0, -170.0)),
    ],
)
def test_a_gimbal_that_looks_down_is_level(tmp_path, yaw, pitch, roll, expected_rpy_deg):
    found = read(image(tmp_path / "a.jpg", xmp=XMP.format(yaw=yaw, pitch=pitch, roll=roll)))
    found_rpy_deg = np.degrees([found.roll_rad, found.pitch_rad, found.yaw_rad])
    assert found_rpy_deg == pytest.approx(expected_rpy_deg, abs=1e-6)
    assert found.height_above_home_m == 40.1


def test_xmp_may_be_written_as_elements(tmp_path: Path):
    xmp = "<drone-dji:RelativeAltitude>+12.5</drone-dji:RelativeAltitude>"
    assert read(image(tmp_path / "a.jpg", xmp=xmp)).height_above_home_m == 12.5


def test_the_images_direction_stands_in_for_the_gimbal(tmp_path: Path):
    gps = gps_tags(1.0, 1.0, 1.0) | {16: "T", 17: 90.0}
    found = read(image(tmp_path / "a.jpg", gps=gps))
    assert found.yaw_rad == pytest.approx(math.pi / 2)
    assert found.roll_rad is None


@pytest.mark.parametrize(
    ("exif", "size", "hfov_deg"),
    [
        # Phantom 3: 94 degrees over the diagonal of 4:3; 16:9 is cut out at full width.
        ({0x920A: 3.61, 0xA405: 20}, (160, 120), 81.7),
        ({0x920A: 3.61, 0xA405: 20}, (160, 90), 81.7),
        # One inch, 13.2 mm wide, 3:2; the equivalent focal length is rounded.
        ({0x920A: 8.8, 0xA405: 24}, (162, 108), 73.7),
        ({0x920A: 8.8, 0xA405: 24}, (160, 90), 73.7),
        # 1000 px on 10 mm, so f = 500 px.
        ({0x920A: 5.0, 0xA20E: 1000.0, 0xA210: 3, 0xA002: 1000}, (160, 120), 90.0),
    ],
)
def test_the_field_of_view_follows_from_the_lens(tmp_path: Path, exif, size, hfov_deg):
    found = read(image(tmp_path / "a.jpg", exif=exif, size=size), size)
    assert found.hfov_deg == pytest.approx(hfov_deg, abs=0.6)


def test_a_calibrated_focal_length_goes_first(tmp_path: Path):
    xmp = '<a drone-dji:CalibratedFocalLength="2000.0"/>'
    found = read(image(tmp_path / "a.jpg", exif={0xA002: 4000, 0xA405: 99}, xmp=xmp))
    assert found.hfov_deg == pytest.approx(90.0)


@pytest.mark.parametrize(("across", "down"), [(0xA002, 0xA003), (0x0100, 0x0101)])
@pytest.mark.parametrize(
    ("exif", "xmp"),
    [
        ({}, '<a drone-dji:CalibratedFocalLength="75.0"/>'),
        ({0x920A: 0.75, 0xA20E: 1000.0, 0xA210: 3}, ""),  # 1000 px on 10 mm
    ],
)
@pytest.mark.parametrize(
    ("size", "hfov_deg"), [((200, 150), 106.26), ((150, 200), 90.0), ((150, 150), 106.26)]
)
def test_a_turned_picture_is_as_wide_as_it_was_high(
    tmp_path: Path, across, down, exif, xmp, size, hfov_deg
):
    tags = {across: 200, down: 150, **exif}
    main, exif = ({}, tags) if across == 0xA002 else (tags, exif)
    found = read(image(tmp_path / "a.jpg", main=main, exif=exif, xmp=xmp, size=size), size)
    assert found.hfov_deg == pytest.approx(hfov_deg, abs=0.01)


def test_a_lens_that_cannot_be_is_none(tmp_path: Path):
    assert read(image(tmp_path / "a.jpg", exif={0xA405: 60_000})).focal_ratio is None


@given(data=st.data())
def test_damaged_metadata_never_raise(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damaged")
    buffer = image(
        folder / "a.jpg",
        exif={0x920A: 3.61, 0xA405: 20, 0xA002: 4000},
        gps=gps_tags(46.8, -92.0, 198.0),
        xmp=XMP.format(yaw="1", pitch="-90", roll="0"),
    ).read_bytes()
    damaged = bytearray(buffer[: data.draw(st.integers(0, len(buffer)))])
    for at in data.draw(st.lists(st.integers(0, max(0, len(damaged) - 1)), max_size=20)):
        if damaged:
            damaged[at] = data.draw(st.integers(0, 255))
    (folder / "b.jpg").write_bytes(damaged)
    found = read(folder / "b.jpg")
    assert found.lat_deg is None or abs(found.lat_deg) <= 90.0


@given(content=st.binary(max_size=300), order=st.sampled_from([b"II*\0", b"MM\0*"]))
def test_any_bytes_may_follow_a_tiff_header(tmp_path_factory, content, order):
    path = tmp_path_factory.mktemp("tiff") / "a.tif"
    path.write_bytes(order + content)
    read(path)


def test_a_missing_file_is_one_line(tmp_path: Path):
    with pytest.raises(SourceError, match=r"cannot read .*none\.jpg"):
        read(tmp_path / "none.jpg")


def test_a_real_drones_images_are_read(data_folder: Path):
    folder = data_folder / "flights" / "brighton_beach" / "images"
    found = read(folder / "DJI_0019.JPG", (1600, 900))
    assert found.lat_deg == pytest.approx(46.8426907, abs=1e-7)
    assert found.lon_deg == pytest.approx(-91.9944273, abs=1e-7)
    assert math.degrees(found.yaw_rad) == pytest.approx(42.8)
    assert math.degrees(found.pitch_rad) == pytest.approx(0.1)
    assert found.hfov_deg == pytest.approx(81.7, abs=0.1)

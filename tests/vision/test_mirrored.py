"""Images whose left and right are exchanged, of ground that is nearly the same mirrored."""

from dataclasses import replace

import numpy as np
import pytest
from vision_scenes import CAMERA, GROUND_PX, HOME, frame_at, ground_pack, texture

from vwnav.maps.pack import MapPack
from vwnav.types import MapFix, Prior, RejectReason
from vwnav.vision.localizer import Localizer

AGL_M = 70.0
EAST_M = 12.0  # of the road's middle
ROAD_PX = 70  # half of its width
NEAR = Prior(
    *HOME.to_geodetic(np.zeros(3))[:2], sigma_m=10.0, yaw_rad=0.0, sigma_yaw_rad=0.05, agl_m=AGL_M
)
ANYWHERE = Prior(agl_m=AGL_M, sigma_agl_ratio=0.05)


@pytest.fixture(scope="module")
def ground():
    """A dual carriageway from south to north: each half of it is the other, mirrored."""
    plan, middle = texture(5), GROUND_PX // 2
    plan[:, middle : middle + ROAD_PX] = plan[:, middle - ROAD_PX : middle][:, ::-1]
    return plan


@pytest.fixture(scope="module")
def pack(ground, orb, tmp_path_factory):
    path = tmp_path_factory.mktemp("road") / "road.mbtiles"
    with MapPack.open(ground_pack(path, ground, (orb,))) as opened:
        yield opened


@pytest.mark.parametrize("prior", [NEAR, ANYWHERE])
def test_a_mirrored_image_is_no_fix_on_the_other_side_of_a_road(ground, pack, orb, prior):
    """They were believed 24 m off here, and of a real video 10 to 160 m, to one."""
    frame = frame_at(ground, 0.0, EAST_M, AGL_M, rng=np.random.default_rng(0))
    mirrored = replace(frame, image=np.ascontiguousarray(frame.image[:, ::-1]))
    outcome = Localizer(pack, orb, CAMERA).localize(mirrored, prior, 0)
    assert getattr(outcome, "reason", None) is RejectReason.MIRRORED
    assert "once it is turned back" in outcome.detail


def test_an_image_that_is_not_is_found_there(ground, pack, orb):
    frame = frame_at(ground, 0.0, EAST_M, AGL_M, rng=np.random.default_rng(0))
    fix = Localizer(pack, orb, CAMERA).localize(frame, NEAR, 0)
    assert isinstance(fix, MapFix)
    found = HOME.to_ned(fix.lat_deg, fix.lon_deg, HOME.alt_amsl_m)
    assert np.hypot(found[0], found[1] - EAST_M) < 0.6

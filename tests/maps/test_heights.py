import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.maps.heights import HeightGrid

BOUNDS = (60.0, 22.0, 60.2, 22.4)
PLANE = HeightGrid(
    BOUNDS,
    (100 + 10 * np.linspace(1, 0, 11)[:, None] + 4 * np.linspace(0, 1, 21)).astype(np.float32),
)


@given(st.floats(60.0, 60.2), st.floats(22.0, 22.4))
def test_a_plane_is_interpolated_exactly(lat_deg: float, lon_deg: float):
    expected = 100 + 10 * (lat_deg - 60.0) / 0.2 + 4 * (lon_deg - 22.0) / 0.4
    assert PLANE.at(lat_deg, lon_deg) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("place", [(59.99, 22.1), (60.1, 22.41), (float("nan"), 22.1)])
def test_heights_outside_are_unknown(place):
    assert PLANE.at(*place) is None


def test_a_hole_makes_its_surroundings_unknown():
    heights = PLANE.heights_m.copy()
    heights[5, 5] = np.nan
    holed = HeightGrid(BOUNDS, heights)
    assert holed.at(60.1 + 0.001, 22.1 + 0.001) is None
    assert holed.at(60.19, 22.39) is not None


def test_heights_come_back_from_their_blob():
    back = HeightGrid.decoded(PLANE.encoded(), (11, 21), BOUNDS)
    assert np.array_equal(back.heights_m, PLANE.heights_m)


@pytest.mark.parametrize(
    ("bounds", "shape"), [(BOUNDS, (1, 5)), (BOUNDS, (5, 5000)), ((60.2, 22.0, 60.0, 22.4), (3, 3))]
)
def test_a_grid_that_makes_no_sense_is_refused(bounds, shape):
    with pytest.raises(ValueError, match="expected"):
        HeightGrid(bounds, np.zeros(shape, np.float32))

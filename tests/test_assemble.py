"""What a flight's settings are once its map is known."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest

from vwnav.assemble import with_map
from vwnav.config import Config
from vwnav.estimation.config import EkfConfig
from vwnav.maps.pack import MapPack
from vwnav.maps.schema import GeoreferenceBasis


@pytest.mark.parametrize(
    ("sigma_m", "basis", "stated_m"),
    [
        (1.0, "estimated", 1.0),
        (1.0, "given", math.sqrt(0.5)),
        (1.0, "assumed", 0.0),
        (1.0, None, 0.0),
        (50.0, "given", 3.0),
    ],
)
def test_what_a_pack_says_of_itself_is_what_a_flight_begins_with(
    sigma_m: float, basis: GeoreferenceBasis | None, stated_m: float
) -> None:
    pack = cast(MapPack, SimpleNamespace(georeference_sigma_m=sigma_m, georeference_basis=basis))
    assert with_map(Config(), pack).ekf.map_stated_sigma_m == pytest.approx(stated_m)


def test_where_a_pack_says_nothing_the_settings_count() -> None:
    config = Config(ekf=replace(EkfConfig(), map_stated_sigma_m=0.7))
    silent, good = (
        cast(MapPack, SimpleNamespace(georeference_sigma_m=0.4, georeference_basis=basis))
        for basis in ("assumed", "estimated")
    )
    assert with_map(config, silent).ekf.map_stated_sigma_m == 0.7
    assert with_map(config, good).ekf.map_stated_sigma_m == 0.4

"""PX4's parameters: names, types, and integers that travel byte by byte."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.errors import ConfigError
from vwnav.sim.px4.parameters import INT32, REAL32, Px4Parameters


@pytest.mark.parametrize(
    ("name", "default"),
    [
        ("EKF2_EV_CTRL", 0),
        ("EKF2_HGT_REF", 1),
        ("COM_OBL_RC_ACT", 0),
        ("COM_OF_LOSS_T", 1.0),
        ("COM_LOW_BAT_ACT", 0),
        ("NAV_DLL_ACT", 0),
        ("COM_RC_OVERRIDE", 1),
        ("MIS_TAKEOFF_ALT", 2.5),
        ("EKF2_DELAY_MAX", 200.0),
    ],
)
def test_defaults_are_px4s(name: str, default: float) -> None:
    assert Px4Parameters(())[name] == default


@given(st.integers(-(2**22), 2**30))
def test_integers_keep_their_bytes(value: int) -> None:
    parameters = Px4Parameters(())
    wire = struct.unpack("<f", struct.pack("<i", value))[0]
    assert parameters.set_wire("COM_OBL_RC_ACT", wire, INT32)
    assert parameters["COM_OBL_RC_ACT"] == value
    assert struct.pack("<f", parameters.wire_value("COM_OBL_RC_ACT")) == struct.pack("<i", value)


def test_the_wire_value_of_one_is_the_recorded_denormal() -> None:
    parameters = Px4Parameters((("EKF2_EV_CTRL", 1),))
    assert parameters.wire_value("EKF2_EV_CTRL") == 1.401298464324817e-45


@pytest.mark.parametrize(
    ("name", "value", "kind"),
    [("MIS_TAKEOFF_ALT", 10.0, INT32), ("EKF2_EV_CTRL", 1.0, REAL32)],
)
def test_a_value_of_the_wrong_type_changes_nothing(name: str, value: float, kind: int) -> None:
    parameters = Px4Parameters(())
    assert not parameters.set_wire(name, value, kind)
    assert parameters[name] == Px4Parameters(())[name]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_float_that_is_no_number_is_refused(value: float) -> None:
    assert not Px4Parameters(()).set_wire("MIS_TAKEOFF_ALT", value, REAL32)


def test_the_hash_changes_with_a_value() -> None:
    changed = Px4Parameters((("MIS_TAKEOFF_ALT", 3.0),))
    assert Px4Parameters(()).hash_wire_value() != changed.hash_wire_value()


def test_an_unknown_parameter_is_a_configuration_error() -> None:
    with pytest.raises(ConfigError, match="EKF3_EV_CTRL"):
        Px4Parameters((("EKF3_EV_CTRL", 1.0),))

"""The filter's inputs as JSON and back, and the log that gives its estimates again."""

import json
from contextlib import suppress
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.errors import SourceError
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import Exposed, NedFix
from vwnav.estimation.inputs import Asked, decode, encode
from vwnav.types import Attitude, Height, ImuSample, OdometryMotion, Range, Stationary

ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)
MAYBE = st.none() | ANY


def arrays(*shape: int):
    size = int(np.prod(shape))
    return st.lists(ANY, min_size=size, max_size=size).map(lambda v: np.reshape(v, shape))


INPUTS = st.one_of(
    st.builds(
        Start, t_s=ANY, position_ned_m=st.none() | arrays(3), sigma_m=ANY, agl_m=ANY,
        sigma_agl_m=ANY, sigma_velocity_m_s=ANY,
    ),
    st.builds(Attitude, ANY, arrays(4)),
    st.builds(ImuSample, ANY, arrays(3), arrays(3), MAYBE),
    st.builds(Height, ANY, ANY),
    st.builds(Range, ANY, ANY),
    st.builds(Stationary, ANY),
    st.builds(
        NedFix, t_s=ANY, position_ne_m=arrays(2), covariance_ne_m2=arrays(2, 2), yaw_rad=MAYBE,
        sigma_yaw_rad=MAYBE, agl_m=MAYBE, sigma_agl_m=MAYBE, sigma_tilt_rad=ANY, sigma_map_m=ANY,
    ),
    st.builds(
        OdometryMotion, ANY, ANY, arrays(3), arrays(3, 3), ANY, ANY, ANY, st.integers(0, 5000)
    ),
    st.builds(Asked, ANY),
    st.builds(Exposed, ANY),
)  # fmt: skip


def bits(value) -> object:
    """Alike for values of the same type, shape and bits; NaN is NaN."""
    if value is None or isinstance(value, int):
        return value
    array = np.asarray(value, np.float64)
    return type(value).__name__, array.shape, np.where(np.isnan(array), np.nan, array).tobytes()


@given(seen=INPUTS)
def test_an_input_comes_back_from_json_to_the_last_bit(seen):
    again = decode(json.loads(json.dumps(encode(seen), allow_nan=False)))
    assert type(again) is type(seen)
    for field in fields(seen):
        assert bits(getattr(again, field.name)) == bits(getattr(seen, field.name))


@pytest.mark.parametrize(
    "content",
    [
        None,
        [],
        {"t_s": 1.0},
        {"kind": "wish", "t_s": 1.0},
        {"kind": "height", "t_s": 1.0},
        {"kind": "height", "t_s": 1.0, "height_m": [2.0]},
        {"kind": "height", "t_s": 1.0, "height_m": 2.0, "depth_m": 3.0},
        {"kind": "attitude", "t_s": 1.0, "quat_wxyz": [[1.0], [2.0, 3.0]]},
        {"kind": "stationary", "t_s": 10**400},
    ],
)
def test_what_is_no_input_says_so(content):
    with pytest.raises(SourceError, match="no input of the filter"):
        decode(content)


@given(told=st.lists(INPUTS, max_size=12))
def test_a_filter_gives_the_same_again_whatever_it_was_told(told):
    """Also of refused inputs, and of starts and times so absurd that it raises."""
    input_log = []
    first, again = flying(input_log), Ekf(EkfConfig())
    with np.errstate(all="ignore"):
        estimates = play(first, [*told, Asked(2.0)])
        recorded = [decode(json.loads(json.dumps(encode(seen)))) for seen in input_log]
        assert play(again, recorded) == estimates
    assert bits(first.state.x) == bits(again.state.x)
    assert bits(first.state.P) == bits(again.state.P)


def play(ekf: Ekf, told: list) -> list:
    """The bits of all estimates that are asked for."""
    found = []
    for seen in told:
        with suppress(Exception):
            estimate = ekf.take(seen)
            if estimate is not None:
                found.append([bits(getattr(estimate, field.name)) for field in fields(estimate)])
    return found


def flying(input_log: list) -> Ekf:
    ekf = Ekf(EkfConfig())
    ekf.record(input_log.append)
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0]), agl_m=50.0))
    for i in range(6):
        ekf.handle(Attitude(0.2 * i, np.array([1.0, 0.0, 0.0, 0.0])))
        ekf.handle(Height(0.2 * i, 50.0))
    return ekf


def test_the_input_log_holds_every_kind_of_input_in_its_order():
    input_log = []
    ekf = flying(input_log)
    del input_log[:]
    told = [
        Range(1.1, 49.0),
        Stationary(1.1),
        Asked(1.2),
        Height(float("nan"), 2.0),
        Attitude(1.2, np.zeros(4)),
        ImuSample(1.2, np.array([0.0, 0.0, -9.8]), np.zeros(3)),
        OdometryMotion(1.0, 1.2, np.zeros(3), np.eye(3), 0.0, 0.1, 50.0, 9),
        NedFix(t_s=1.2, position_ne_m=np.zeros(2), covariance_ne_m2=np.eye(2)),
        Exposed(1.2),
        Start(t_s=1.3),
    ]
    for seen in told:
        ekf.take(seen)
    assert [encode(seen) for seen in input_log] == [encode(seen) for seen in told]

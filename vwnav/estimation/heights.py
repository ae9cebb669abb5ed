"""Heights meet the state: barometer, rangefinder, height above ground of a fix, standing.

A rangefinder is believed only while other witnesses of the height bear it: one that is stuck,
dirty, or looks at tree tops says a height as often as one that measures. The ground itself may
step: that is believed of its word alone only where no map fix tells the height, and by no more than
ground can have risen on the way since it last agreed.
"""

import math
from dataclasses import replace

import numpy as np

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context
from vwnav.estimation.disputes import (
    BAROMETER_OFF_M,
    convinces,
    freed,
    height_opened,
    range_doubted,
    remember,
)
from vwnav.estimation.fixes import apply_agl
from vwnav.estimation.inertial.attitudes import AttitudeHistory, down_axis, level_axes, yaw_of
from vwnav.estimation.inertial.preintegration import preintegrated
from vwnav.estimation.states import (
    CHI_SQUARE_GATE,
    FilterState,
    Innovation,
    Measurement,
    RangeTrust,
    States,
    Verdict,
    correct,
    fuse,
)
from vwnav.geometry.rotations import vector_from_quat
from vwnav.types import Array, Height, Range

_LEAST_COS_TILT = 0.5
_FIX_TELLS_S = 5.0  # the height, for so long
_HIGHEST_STEP_M = 5.0  # of the ground: a house, a wall, a bank
_STEEPEST = 1.0  # it rises, per metre flown since the rangefinder last agreed
_HOLLOW_M = 0.3  # and as much without any way
_DRAWN_S, _DRAWN_SIGMAS = 10.0, 4.0  # within so long they draw the bias along by no more
_CLOSE = 4.0  # two sigmas: those of who measures are closer, again and again
_AGREES_S = 3.0  # for so long one that was doubted must agree again
_PLACE = tuple(range(States.SIZE))[States.POSITION_NE]
_STILL_S = 0.2
_REST_SHARE = 0.3
_CLIMB_SIGMA_M_S = 5.0  # of an aircraft whose barometer was not believed
_UNTHOUGHT_CLIMB_M_S = 12.0  # by which a climb may differ from the one believed
_CLIMB_DRIFT_M_S = 15.0  # by which agreeing barometric heights may part: it climbs meanwhile


def apply_height(
    state: FilterState, event: Height, config: EkfConfig
) -> tuple[FilterState, Innovation]:
    """Fuse a barometric height.

    A gust at the port is refused. When several heights agree, either the pressure has stepped,
    faster than any climb: then the barometer's bias is freed, and the height is left to those who
    did not see it step. Or the aircraft has climbed or sunk as nobody thought, and height and climb
    are freed: a filter that refused its barometer for good flew at 90 m and took it for 60.
    """
    stepped = _stepped(state, event, config)
    state = state._replace(newest_height=(event.t_s, event.height_m))
    H = np.zeros((1, States.SIZE))
    H[0, States.DOWN], H[0, States.BARO] = -1.0, 1.0
    R = np.array([[config.height_sigma_m**2 + _lag_m2(state, config.height_lag_s)]])
    measurement = Measurement(event.height_m - H @ state.x, H, R)
    fused, innovation = fuse(state, measurement)
    if innovation.verdict is Verdict.FUSED:
        fused = fused._replace(rejected_heights=(), height_stepped=False)
        return _touch(fused, config), innovation
    first = not state.rejected_heights
    state = state._replace(height_stepped=stepped if first else state.height_stepped or stepped)
    rejected = remember(state.rejected_heights, state.t_s, measurement, config.dispute_window_s)
    state = state._replace(rejected_heights=rejected)
    if not convinces(rejected, _CLIMB_DRIFT_M_S, config.offset_count, config.offset_span_s):
        return state, innovation
    open_m = 2.0 * abs(float(measurement.residual[0]))
    if state.height_stepped:
        state = freed(state, States.BARO, open_m)
    else:
        # Whether the keyframe's height was believed wrong too is not known.
        state = freed(freed(state, States.DOWN, open_m), States.ANCHOR_DOWN, open_m)
        state = freed(state, States.VELOCITY_DOWN, _CLIMB_SIGMA_M_S)
    fused = correct(state, measurement)._replace(rejected_heights=(), height_stepped=False)
    return fused, replace(innovation, verdict=Verdict.RELOCATED)


def _lag_m2(state: FilterState, lag_s: float) -> float:
    """Variance of what a height is wrong by because it is late."""
    return float((lag_s * state.x[States.VELOCITY_DOWN]) ** 2)


def _stepped(state: FilterState, event: Height, config: EkfConfig) -> bool:
    """Whether the height changed from one sample to the next by more than a climb explains."""
    if state.newest_height is None:
        return False
    t0_s, height0_m = state.newest_height
    span_s = max(event.t_s - t0_s, 0.0)
    rose_m = event.height_m - height0_m + span_s * float(state.x[States.VELOCITY_DOWN])
    noise_m = math.sqrt(2.0 * CHI_SQUARE_GATE[1]) * config.height_sigma_m
    return abs(rose_m) > noise_m + _UNTHOUGHT_CLIMB_M_S * span_s


def _touch(state: FilterState, config: EkfConfig) -> FilterState:
    """Near the ground an aircraft hardly moves sideways, whatever its attitude seems to say.

    Autopilots tell a landing seconds after the touch. Until then a level aircraft in wind looks as
    if the wind blew it away, at a height where no image tells otherwise. One that was believed to
    move before it came so low does fly there: the ground may fall away below it. It is the ground
    that stops it, which tells nothing of how it flew, nor of the place where that has led. And one
    of which no landing is told for seconds hovers, and drifts as it likes.
    """
    if state.agl_m > config.touching_agl_m:
        return state._replace(above_s=state.t_s)
    state = state._replace(above_s=min(state.above_s, state.t_s))
    speed_m_s = float(np.hypot(*state.x[States.VELOCITY_NE]))
    is_long = state.t_s - state.above_s > config.touching_s
    if is_long or speed_m_s > config.touching_speed_m_s:
        return state
    H = np.zeros((2, States.SIZE))
    H[:, States.VELOCITY_NE] = np.eye(2)
    R = config.touching_sigma_m_s**2 * np.eye(2)
    slow = Measurement(-state.x[States.VELOCITY_NE], H, R, considered=_PLACE)
    return fuse(state, slow)[0]


def apply_range(
    state: FilterState, event: Range, attitudes: AttitudeHistory, config: EkfConfig
) -> tuple[FilterState, Innovation]:
    """Fuse the distance to the ground along the body's down axis, unless that is far from down.

    An axis that leans by more or less than the autopilot says is as much longer or shorter: with
    the tilt's error e about forward and right, cos = d_down - (e_f d_r - e_r d_f).
    """
    attitude = attitudes.at(event.t_s)
    if attitude is None:
        return state, Innovation(Verdict.NO_ATTITUDE)
    forward, right, cos = down_axis(attitude.quat_wxyz)
    if cos < _LEAST_COS_TILT:
        return state, Innovation(Verdict.IMPOSSIBLE)
    agl_m = event.distance_m * cos
    H = np.zeros((1, States.SIZE))
    H[0, States.DOWN] = H[0, States.TERRAIN] = -1.0
    # It meets the ground beside what is right below.
    axes = level_axes(yaw_of(attitude.quat_wxyz) - float(state.x[States.HEADING_BIAS]))
    H[0, States.SLOPE] = -max(state.agl_m, 0.0) * axes @ np.array([forward, right]) / cos
    H[0, States.TILT] = event.distance_m * right, -event.distance_m * forward
    variance = (
        config.rangefinder_sigma_m**2
        + state.relief_m**2
        + (config.rangefinder_sigma_ratio * event.distance_m) ** 2
        + float(config.rangefinder_lag_s * state.x[States.VELOCITY_DOWN]) ** 2
    )
    return _weighed(state, Measurement(agl_m - H @ state.x, H, np.array([[variance]])), config)


def _weighed(
    state: FilterState, measurement: Measurement, config: EkfConfig
) -> tuple[FilterState, Innovation]:
    """Believe it, refuse it, or doubt the rangefinder from now on."""
    fused, innovation = fuse(state, measurement)
    trust, drawn_m = state.range_trust, _drawn_m(state, config)
    if drawn_m > 0.0:
        return range_doubted(state, drawn_m), replace(innovation, verdict=Verdict.DOUBTED)
    agrees = innovation.verdict is Verdict.FUSED
    if trust.doubted_s is not None:
        agrees = agrees and _borne(state, measurement, innovation)
        since_s = trust.doubted_s if agrees else state.t_s
        state = state._replace(range_trust=replace(trust, doubted_s=since_s))
        if state.t_s - since_s < _AGREES_S:
            return _torn(state, measurement), replace(innovation, verdict=Verdict.DOUBTED)
        trust = state.range_trust
    if agrees:
        north_m, east_m = state.x[States.POSITION_NE].tolist()
        trust = RangeTrust((north_m, east_m), barometer=_barometer(state))
        return fused._replace(range_trust=trust), innovation
    rejected = remember(trust.rejected, state.t_s, measurement, config.dispute_window_s)
    if not convinces(rejected, 1.0, config.offset_count, config.offset_span_s):
        return state._replace(range_trust=replace(trust, rejected=rejected)), innovation
    off_m = abs(float(measurement.residual[0]))
    if off_m > _most_step_m(state):
        return range_doubted(state), replace(innovation, verdict=Verdict.DOUBTED)
    # Whether the keyframe's ground was believed wrong too is not known.
    state = freed(freed(state, States.TERRAIN, 2.0 * off_m), States.ANCHOR_TERRAIN, 2.0 * off_m)
    state = correct(state, measurement)._replace(range_trust=replace(trust, rejected=()))
    return state, replace(innovation, verdict=Verdict.RELOCATED)


def _borne(state: FilterState, measurement: Measurement, innovation: Innovation) -> bool:
    """Whether what is in its gate bears a rangefinder that is doubted.

    Between it and the barometer a fix decides, and closely: height and bias are open to both.
    """
    if state.range_trust.drawn_m > 0.0:
        assert innovation.nis is not None
        return _fix_tells(state) and innovation.nis < _CLOSE
    near_m2 = CHI_SQUARE_GATE[1] * float(measurement.R[0, 0])
    return float(measurement.residual[0]) ** 2 <= near_m2


def _torn(state: FilterState, measurement: Measurement) -> FilterState:
    """While rangefinder and barometer part, the height is as unsure as they are apart."""
    trust, off_m = state.range_trust, abs(float(measurement.residual[0]))
    off_m = min(off_m, BAROMETER_OFF_M)
    if trust.drawn_m == 0.0 or off_m <= trust.drawn_m or _fix_tells(state):
        return state
    more_m = math.sqrt(off_m**2 - trust.drawn_m**2)
    return height_opened(state, more_m)._replace(range_trust=replace(trust, drawn_m=off_m))


def _barometer(state: FilterState) -> tuple[float, float, float]:
    """What its bias was some seconds ago, or is."""
    before = state.range_trust.barometer
    if before is not None and state.t_s - before[0] < _DRAWN_S:
        return before
    return state.t_s, float(state.x[States.BARO]), float(state.P[States.BARO, States.BARO])


def _drawn_m(state: FilterState, config: EkfConfig) -> float:
    """By how much distances have moved the barometer's bias, if by more than weather does.

    Where a fix tells the height the barometer is not their only witness.
    """
    if state.range_trust.barometer is None or _fix_tells(state):
        return 0.0
    since_s, bias_m, variance = state.range_trust.barometer
    span_s = state.t_s - since_s
    climbed_m = abs(float(state.x[States.VELOCITY_DOWN])) * span_s
    variance += config.baro_walk_m**2 * span_s + config.baro_climb_walk_m**2 * climbed_m
    moved_m = abs(float(state.x[States.BARO]) - bias_m)
    return moved_m if moved_m > _DRAWN_SIGMAS * math.sqrt(variance) else 0.0


def _fix_tells(state: FilterState) -> bool:
    return state.t_last_fix_s is not None and state.t_s - state.t_last_fix_s < _FIX_TELLS_S


def _most_step_m(state: FilterState) -> float:
    """By how much the ground below may have stepped, for all that others know."""
    agreed_ne_m = state.range_trust.agreed_ne_m
    if agreed_ne_m is None or _fix_tells(state):
        return 0.0
    way_m = math.dist(agreed_ne_m, state.x[States.POSITION_NE].tolist())
    return min(_HOLLOW_M + _STEEPEST * way_m, _HIGHEST_STEP_M)


def apply_stationary(state: FilterState, context: Context) -> tuple[FilterState, Innovation]:
    """It does not move, and the ground is right below; what the gyro still says is its bias."""
    config = context.config
    state = state._replace(stood_s=state.t_s, above_s=state.t_s)
    H = np.zeros((3, States.SIZE))
    H[:, States.VELOCITY] = np.eye(3)
    R = config.stationary_sigma_m_s**2 * np.eye(3)
    velocity = state.x[States.VELOCITY]
    state, innovation = fuse(state, Measurement(-velocity, H, R))
    if innovation.verdict is Verdict.GATED:
        # Who stands does not move, whatever was believed in the landing: it is open to that.
        P = state.P.copy()
        P[States.VELOCITY, States.VELOCITY] += np.diag((_REST_SHARE * velocity) ** 2)
        return state._replace(P=P), innovation
    imu = context.imu
    felt = preintegrated(imu.until(state.t_s - _STILL_S), imu.until(state.t_s))
    if felt is not None:
        state = _at_rest(state, vector_from_quat(felt.turn_wxyz) / _STILL_S, config)
    state, height = apply_agl(state, config.stationary_agl_m, config.stationary_agl_sigma_m, config)
    return state, replace(innovation, parts=(height,))


def _at_rest(state: FilterState, rates_rad_s: Array, config: EkfConfig) -> FilterState:
    """What a gyro (3,) says of an aircraft that stands; one that is carried about is refused."""
    H = np.zeros((3, States.SIZE))
    H[:, States.GYRO_BIAS] = np.eye(3)
    R = config.stationary_sigma_rad_s**2 * np.eye(3)
    return fuse(state, Measurement(rates_rad_s - state.x[States.GYRO_BIAS], H, R))[0]

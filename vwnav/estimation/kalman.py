"""The Kalman update: one function for every measurement, and what it says about it.

Innovations that the gates reject may be right after all: enough of them must agree.
"""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from vwnav.estimation.states import FilterState, RejectedInnovation, RejectedInnovations, States
from vwnav.types import Array

# 99.9 % of chi-square by degrees of freedom (scipy.stats.chi2.ppf(0.999, dof)).
CHI_SQUARE_GATE = {1: 10.828, 2: 13.816, 3: 16.266}


_RIDGE = 1e-12
_MOST_REMEMBERED = 64  # rejected innovations
_HEADINGS = [States.HEADING_BIAS, States.ANCHOR_HEADING_BIAS, States.EXPOSED_HEADING_BIAS]


class Verdict(Enum):
    """What became of a measurement."""

    FUSED = "fused"
    GATED = "too far from the prediction"
    RELOCATED = "the filter jumped to it"
    UNCONFIRMED = "waits for a second one that agrees"
    NOT_FINITE = "not a finite, sensible measurement"
    TOO_LATE = "older than the history"
    AHEAD = "from the future"
    DUPLICATE = "already there"
    NO_ANCHOR = "its keyframe is not known"
    NO_ATTITUDE = "no attitude that is believed tells how it was seen"
    ON_GROUND = "the aircraft stands, or nearly"
    IMPOSSIBLE = "no aircraft does that"
    DISTRUSTED = "most of its kind contradict the IMU"
    HEADING_UNKNOWN = "the heading is not known yet"
    NOT_STARTED = "the filter is not initialised"


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """What a measurement said against the prediction.

    Attributes:
        nis: normalised innovation squared, None when it was not compared.
        dof: its degrees of freedom. residual: (dof,) measured minus predicted.
        parts: the heading and AGL of a fix, the heading of odometry.
    """

    verdict: Verdict
    nis: float | None = None
    dof: int = 0
    residual: Array | None = None
    parts: tuple["Innovation", ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether the state now contains it."""
        return self.verdict in (Verdict.FUSED, Verdict.RELOCATED)


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """A linearised measurement: residual (m,), its Jacobian H (m, n) and noise R (m, m).

    Attributes:
        considered: consider states (Schmidt 1966), uncertain in it but not corrected by it: its
            model of them is too rough. Nor does it correct what their errors have done to other
            states: a place that is wrong because the heading is stays so until one of them is told.
    """

    residual: Array
    H: Array
    R: Array
    considered: tuple[int, ...] = ()


def fuse(
    state: FilterState, measurement: Measurement, visual_weight: float = 0.0
) -> tuple[FilterState, Innovation]:
    """Correct by a measurement unless its gate refuses it, by chi-square of its dimension.

    `visual_weight` is the lambda of the thesis' eq. 3.30: x + K r, then a part lambda of what is
    still missing. That part goes along the least change of the measured states that explains it:
    K' = K + lambda H^+ (I - H K).
    """
    innovation, K = _compare(state, measurement)
    if innovation.verdict is Verdict.GATED:
        return state, innovation
    if visual_weight > 0.0:
        H = measurement.H
        K = K + visual_weight * np.linalg.pinv(H) @ (np.eye(len(H)) - H @ K)
    return _corrected(state, measurement, K), innovation


def correct(state: FilterState, measurement: Measurement) -> FilterState:
    """Correct by a measurement, whatever its gate says."""
    return _corrected(state, measurement, _compare(state, measurement)[1])


def _compare(state: FilterState, measurement: Measurement) -> tuple[Innovation, Array]:
    """The innovation, and the gain K (n, m) for it: optimal but for consider states."""
    r, H = measurement.residual, measurement.H
    PHt = state.P @ H.T
    S = H @ PHt + measurement.R
    if len(r) == 1:
        K, nis = PHt / S[0, 0], float(r[0] ** 2 / S[0, 0])
    elif measurement.considered:
        K = _schmidt_gain(state.P, PHt, measurement)
        nis = float(r @ np.linalg.solve(S, r))
    else:
        solved = np.linalg.solve(S, np.column_stack([r, PHt.T]))
        K, nis = solved[:, 1:].T, float(r @ solved[:, 0])
    verdict = Verdict.FUSED if nis <= CHI_SQUARE_GATE[len(r)] else Verdict.GATED
    return Innovation(verdict, nis, len(r), r), K


def _schmidt_gain(P: Array, PHt: Array, measurement: Measurement) -> Array:
    """The gain (n, m) that would be optimal if the consider states c were known as they are.

    P given c is P - P_c P_cc^-1 P_c^T; only its product with H^T is needed.

    With the optimal gain and its rows of c at zero, places far from the last fix were moved by the
    heading error that the residual seemed to show, metres at a time, and the heading was not.
    """
    c, H = list(measurement.considered), measurement.H
    P_c = P[:, c]
    # A clone of a state that is cloned anew has all but its covariance: the ridge keeps it regular.
    P_cc = P_c[c] + _RIDGE * np.eye(len(c))
    given = PHt - P_c @ np.linalg.solve(P_cc, PHt[c])
    K = np.array(np.linalg.solve(H @ given + measurement.R, given.T).T, dtype=np.float64)
    K[c] = 0.0
    return K


def _corrected(state: FilterState, measurement: Measurement, K: Array) -> FilterState:
    """Joseph's form keeps P symmetric and positive for any gain; headings stay in [-pi, pi)."""
    A = np.eye(States.SIZE) - K @ measurement.H
    P = A @ state.P @ A.T
    P += (K @ measurement.R) @ K.T
    x = state.x + K @ measurement.residual
    x[_HEADINGS] = (x[_HEADINGS] + np.pi) % (2.0 * np.pi) - np.pi
    return replace(state, x=x, P=0.5 * (P + P.T))


def freed(state: FilterState, index: int, sigma: float) -> FilterState:
    """Forget how sure one state was: its correlations go, its sigma is as given."""
    P = state.P.copy()
    P[index, :] = 0.0
    P[:, index] = 0.0
    P[index, index] = sigma**2
    return replace(state, P=P)


def remember(
    rejected: RejectedInnovations, t_s: float, measurement: Measurement, window_s: float
) -> RejectedInnovations:
    """The rejected innovations of the last `window_s`, with that of a measurement at the end."""
    newest = RejectedInnovation(t_s, measurement.residual, measurement.R)
    recent = [before for before in rejected if before.t_s >= t_s - window_s]
    return (*recent, newest)[-_MOST_REMEMBERED:]


def agreeing(rejected: RejectedInnovations, drift_per_s: float) -> RejectedInnovations:
    """Those that want the same change as the newest one, itself included.

    Two agree when their residuals differ by no more than their covariances, and the drift that the
    prediction may have made between them, explain at 99.9 %.
    """
    newest = rejected[-1]
    gate = CHI_SQUARE_GATE[len(newest.residual)]
    unit = np.eye(len(newest.residual))
    same = []
    for before in rejected:
        drift = drift_per_s * (newest.t_s - before.t_s)
        spread = before.covariance + newest.covariance + drift**2 * unit
        apart = newest.residual - before.residual
        if apart @ np.linalg.solve(spread, apart) <= gate:
            same.append(before)
    return tuple(same)


def convinces(rejected: RejectedInnovations, drift_per_s: float, count: int, span_s: float) -> bool:
    """Whether at least `count` over at least `span_s` agree, and at most a third does not."""
    same = agreeing(rejected, drift_per_s)
    recent = sum(each.t_s >= same[0].t_s for each in rejected)
    return (
        len(same) >= count
        and same[-1].t_s - same[0].t_s >= span_s
        and len(same) >= 2.0 / 3.0 * recent
    )

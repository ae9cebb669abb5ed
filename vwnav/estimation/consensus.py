"""When measurements that the gates refuse are right after all: enough of them must agree."""

import numpy as np

from vwnav.estimation.states import Dispute
from vwnav.estimation.updates import CHI_SQUARE_GATE

_MOST_REMEMBERED = 64


def remember(
    disputes: tuple[Dispute, ...], newest: Dispute, window_s: float
) -> tuple[Dispute, ...]:
    """The disputes of the last `window_s` with the newest one at the end."""
    recent = [d for d in disputes if d.t_s >= newest.t_s - window_s]
    return (*recent, newest)[-_MOST_REMEMBERED:]


def agreeing(disputes: tuple[Dispute, ...], drift_per_s: float) -> tuple[Dispute, ...]:
    """Those that want the same change as the newest one, itself included.

    Two agree when their offsets differ by no more than their covariances, and the drift that the
    prediction may have made between them, explain at 99.9 %.
    """
    newest = disputes[-1]
    gate = CHI_SQUARE_GATE[len(newest.offset)]
    unit = np.eye(len(newest.offset))
    same = []
    for d in disputes:
        drift = drift_per_s * (newest.t_s - d.t_s)
        spread = d.covariance + newest.covariance + drift**2 * unit
        apart = newest.offset - d.offset
        if apart @ np.linalg.solve(spread, apart) <= gate:
            same.append(d)
    return tuple(same)


def convinces(disputes: tuple[Dispute, ...], drift_per_s: float, count: int, span_s: float) -> bool:
    """Whether at least `count` over at least `span_s` agree, and at most a third does not."""
    same = agreeing(disputes, drift_per_s)
    recent = sum(d.t_s >= same[0].t_s for d in disputes)
    return (
        len(same) >= count
        and same[-1].t_s - same[0].t_s >= span_s
        and len(same) >= 2.0 / 3.0 * recent
    )

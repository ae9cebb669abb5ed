"""Which estimates an autopilot may be given."""

import numpy as np

from vwnav.types import Estimate

MAX_SENT_VELOCITY_SIGMA_M_S = 4.0
MAX_SENT_SPEED_M_S = 35.0


def is_flyable(estimate: Estimate) -> bool:
    """Whether an autopilot may steer by it.

    It chases whatever velocity it is told. One that has lost its own comes down level by itself
    (Descend, Land) when estimates stop; one that follows a runaway estimate flies away.
    """
    if not np.all(np.isfinite(estimate.covariance)):
        return False
    variance = float(np.linalg.eigvalsh(estimate.covariance[3:5, 3:5])[-1])
    speed_m_s = float(np.hypot(*estimate.velocity_ned_m_s[:2]))
    return variance < MAX_SENT_VELOCITY_SIGMA_M_S**2 and speed_m_s < MAX_SENT_SPEED_M_S

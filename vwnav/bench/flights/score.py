"""One flight in numbers: errors against the truth, honesty, what it broke."""

import math

import numpy as np

from vwnav.bench.flights.campaign import FlightScore, Sortie
from vwnav.bench.flights.judge import judge
from vwnav.bench.flights.log import flight_log
from vwnav.bench.flights.scenario import Flown
from vwnav.mission.mission import Phase
from vwnav.rules.belief import estimate_sigmas
from vwnav.rules.flight_log import FlightLog, Sent
from vwnav.rules.moments import flying, in_phases
from vwnav.rules.temporal import inside
from vwnav.sim.named_sites import SITE_PREFIX
from vwnav.types import Array, MapFix, RejectReason

WRONG_FIX_M = 20.0
_SAMPLE_S = 1.0
_FRESH_S = 0.2  # autopilots stop fusing after that
_NOT_TRIED = (RejectReason.NOT_TRIED, RejectReason.TOO_LOW)


def score(sortie: Sortie, site: str, way_ne_m: Array, flown: Flown, cpu_s: float) -> FlightScore:
    """Hold a flight against its truth; `way_ne_m` (n, 2) is the line that it was to fly."""
    log, setup = flight_log(flown), flown.scenario.setup
    since_s = min((fix.t_s for fix in log.fixes), default=math.inf)
    sent = _sent_in_the_air(log, since_s)
    sigmas = dict(estimate_sigmas(log))
    errors = [_error_m(log, each) for each in sent]
    outcomes = [step.outcome for step in flown.steps]
    tried = [o for o in outcomes if isinstance(o, MapFix) or o.reason not in _NOT_TRIED]
    truth = np.array([row.position_ned_m[:2] for row in log.truth])
    verdict = judge(flown)
    each_second = [i for i, _ in _thinned([each.t_s for each in sent])]
    return FlightScore(
        manners=sortie.manners,
        number=sortie.number,
        site=site.removeprefix(SITE_PREFIX),
        seed=setup.seed,
        wind_m_s=setup.wind_m_s,
        wind_from_deg=round(setup.wind_from_deg, 1),
        flown_s=round(flown.flown_s, 1),
        way_m=round(float(np.hypot(*np.diff(truth[::50], axis=0).T).sum()), 1),
        wrong=verdict.wrong,
        errors_m=tuple(round(errors[i], 3) for i in each_second),
        nees=tuple(round(sigmas.get(sent[i].t_s, 0.0) ** 2, 3) for i in each_second),
        worst_m=round(max(errors, default=0.0), 3),
        cross_m=_cross_track(log, way_ne_m),
        touchdown_m=None if verdict.landed_off_m is None else round(verdict.landed_off_m, 3),
        available=round(_available(log, since_s), 4),
        fixes=sum(isinstance(outcome, MapFix) for outcome in tried),
        attempts=len(tried),
        wrong_fixes=_wrong_fixes(log),
        cpu_s=round(cpu_s, 1),
    )


def _sent_in_the_air(log: FlightLog, since_s: float) -> list[Sent]:
    spans = flying(log)
    return [each for each in log.estimates if each.t_s >= since_s and inside(each.t_s, spans)]


def _error_m(log: FlightLog, sent: Sent) -> float:
    truth = log.true_place_ne_m(sent.stamp_s)
    return 0.0 if truth is None else math.dist(sent.position_ned_m[:2], truth)


def _thinned(times_s: list[float]) -> list[tuple[int, float]]:
    """(index, time) of the first in each second."""
    kept: list[tuple[int, float]] = []
    for i, t_s in enumerate(times_s):
        if not kept or t_s - kept[-1][1] >= _SAMPLE_S - 1e-6:
            kept.append((i, t_s))
    return kept


def _cross_track(log: FlightLog, way_ne_m: Array) -> tuple[float, ...]:
    spans = in_phases(log, Phase.ROUTE)
    rows = [row for row in log.truth if inside(row.t_s, spans)]
    places = [rows[i].position_ned_m[:2] for i, _ in _thinned([row.t_s for row in rows])]
    return tuple(round(distance_m(np.array(place), way_ne_m), 3) for place in places)


def distance_m(place_ne_m: Array, way_ne_m: Array) -> float:
    """From a place (2,) to the nearest point of a line through places (n, 2), n >= 2."""
    start, leg = way_ne_m[:-1], np.diff(way_ne_m, axis=0)
    square = np.maximum(np.sum(leg**2, axis=1), 1e-12)
    along = np.clip(np.sum((place_ne_m - start) * leg, axis=1) / square, 0.0, 1.0)
    return float(np.min(np.hypot(*(start + along[:, None] * leg - place_ne_m).T)))


def _available(log: FlightLog, since_s: float) -> float:
    """Looked at each moment that the vehicle was noted."""
    limit_m, flown = log.bounds.safety.hold_sigma_m, flying(log)
    moments = np.array([r.t_s for r in log.vehicle if r.t_s >= since_s and inside(r.t_s, flown)])
    good = np.array([each.t_s for each in log.estimates if each.sigma_m <= limit_m])
    if not len(moments) or not len(good):
        return 0.0
    newest = np.searchsorted(good, moments, side="right") - 1
    age_s = np.where(newest >= 0, moments - good[np.maximum(newest, 0)], np.inf)
    return float(np.mean(age_s <= _FRESH_S))


def _wrong_fixes(log: FlightLog) -> int:
    truths = ((fix, log.true_place_ne_m(fix.t_s)) for fix in log.fixes)
    return sum(t is not None and math.dist(fix.ne, t) > WRONG_FIX_M for fix, t in truths)

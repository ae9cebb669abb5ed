"""Whether the ways that images tell are those of the aircraft, as the IMU feels it fly.

A camera whose pictures are mirrored, or that shows what is not there, tells ways that the filter
refuses one by one, and believes now and then. When most of them are refused none is believed, until
they agree for a while and a map fix does. That has to be while the aircraft changes its speed: ways
of images that are dated wrongly agree as long as it flies steadily.

The images themselves tell it earlier, and need no filter for it: those of a camera upside down
tilt the other way whenever the aircraft does (`OdometryMotion.tilts_along`). So they tell by how
much a camera is turned on its mount (`MountCheck`): as the compass' error it cost an aircraft.
"""

import math
from collections import deque
from dataclasses import replace
from operator import attrgetter
from typing import NamedTuple, Protocol

import numpy as np

from vwnav.estimation.beginning.lens import may_be_the_lens
from vwnav.estimation.beginning.mount import LEAST_SURE, OVERSTATED, KnockCheck, hangs
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.events import CameraReturned, Displacement, Event, NewKeyframe, Recalibrated
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.inertial.dates import DateCheck
from vwnav.estimation.inertial.imu import ImuHistory
from vwnav.estimation.odometry import between, zoomed
from vwnav.estimation.states import FilterState, Innovation, Verdict
from vwnav.types import Array, OdometryMotion

_HARD_LEAN = 0.25  # tangent; of less the along part is within what odometry says of itself
_STRETCHED = 0.8  # of its height, by the turn of the rows read before and after an image's date
_BLURRED_CLIMB_M_S = 0.5  # one sigma of a climb then
_TELLS_FROM_M = 3.0  # of height; lower, blades and blur are what an image shows
_WINDOW_S, _LEAST = 1.2, 6  # ways in it
_GAP_S = 0.5  # after which it is the filter that may be wrong
_DOUBTED, _TRUSTED = 0.5, 0.9  # share that agrees: at most, and at least
_DOUBTED_UNBORNE, _UNBORNE = 0.8, 3  # of ways that no map fix bears: so many were refused in a row
_DOUBTED_HARDLY = 0.75  # where most are further off ...
_NEAR_NIS = 11.345  # ... than 99 % of right ones are (three degrees of freedom)
_AGREE_S = 2.4  # for so long they have to agree to be believed again ...
_BEARING = 3  # map fixes that bear what ways have told
_LONGER, _FORGIVEN_S = 8.0, 60.0  # times as long when they were lost again within this
_NOISE_M = 0.5  # of a way
_ZOOMED_AGAIN_S = 30.0  # what leaps more often is no lens
_IMU_OF_NOW_S = 0.2  # so old it may be to have felt an image's way
_APART_S = 0.5  # neighbours share their errors: so long after each other they are two witnesses
_MOST_ALONG = 5.0  # what one says at most, and those of one keyframe
_SURE_ALONG = 7.0  # of them all, once in a thousand; that they do is remembered twice as long
_MOST_TOLD, _MOST_SHARE = 20.0, 0.2  # by one image: several have to agree
_MOST_OF_ONE = np.array([3.0, 1.2])  # witnesses of one keyframe, all in all and since it broke
_MOST_TURNS = 4  # in a flight; a mirrored image seems turned by this and that
_FRESH_S = 10.0  # after an image that could not be followed
CAMERA_GONE_S = 1.0  # without an image; its driver may have begun in another mode then
_VERDICT = attrgetter("verdict")
_JUDGED = (Verdict.FUSED, Verdict.GATED, Verdict.DISTRUSTED)  # held against the IMU
_LENS_DOUBTED = "what the pictures show contradicts the IMU: the lens may not be as calibrated"
_CONTRADICTS = "what the pictures show contradicts the IMU: their ways are not used"
_AGREES = "the pictures' ways agree with the IMU again"


class _Way(NamedTuple):
    t_s: float
    agrees: bool
    is_near: bool


class _History(Protocol):
    """What the gate asks of the filter's `Timeline`."""

    oldest: FilterState
    newest: FilterState

    def keyframe_known(self, t_s: float) -> bool: ...

    def insert(self, event: Event) -> Innovation: ...


class OdometryGate:
    """Lets ways into the timeline, and learns what the filter's gate said of each.

    Attributes:
        lost: none is to be believed.
        fixes: map fixes that were where the aircraft is believed, since ways are believed, or
            lost: its images are of here, upright and in scale. Who takes one counts it.
        lens_doubted: before the first fix they contradicted the IMU though the camera hangs
            upright: its lens, perhaps, is not as calibrated. Then they tell the filter of that, and
            are lost where it does not help.
        borne: whether enough of them had borne the ways that are lost now; one or two are right of
            wrong ways too.
        believed_s: time of the first way since they are believed.
    """

    def __init__(self, attitudes: AttitudeHistory, imu: ImuHistory, config: EkfConfig) -> None:
        self._attitudes, self._imu, self._config = attitudes, imu, config
        self._dates = DateCheck()
        self._newest: OdometryMotion | None = None
        self._zoomed_s = -math.inf
        self.lens_doubted = False
        self.other_camera()

    def other_camera(self) -> None:
        """Forget all that was seen: what comes is another camera's."""
        self._along = 0.0  # log-likelihood ratio: the images tilt as the attitude does, or not
        self._by_keyframe = (-math.inf, 0.0)  # what those of the last keyframe have said of it
        self._turned = False  # they surely do not
        self._in_scale = False  # a fix has shown the height that is believed
        self.trust_all()

    def trust_all(self) -> None:
        """Forget what was seen of ways: those that come are not contradicted."""
        self._seen: deque[_Way] = deque()
        self._begun_s = math.inf  # of what is in the window
        self.believed_s = math.inf
        self._lost_s = -math.inf
        self._agree_s = _AGREE_S
        self.fixes = 0
        self.lost = self.borne = False

    def displacement(self, motion: OdometryMotion) -> Displacement:
        """As unsure as an aircraft that tilts fast makes it: images are dated to milliseconds.

        A turn is taken for a way across the line of sight, as long as the ground is far along it,
        and, where that meets the ground aslant, for one along it by the tangent of the lean. Near
        the ground, or in a turn whose rows are read one after the other, images do not grow as they
        should: of a climb they tell little.
        """
        covariance = motion.covariance_ned_m2
        for t_s in (motion.t0_s, motion.t1_s):
            _, yaw_rad, (forward, right), tilts_rad_s, *_ = self._attitudes.exposure(t_s)
            off_rad = self._config.picture_date_s * tilts_rad_s
            c, s = math.cos(yaw_rad), math.sin(yaw_rad)
            sight_m = motion.agl_m * np.array([c * forward - s * right, s * forward + c * right, 1])
            across_m2 = sight_m @ sight_m * np.eye(3) - np.outer(sight_m, sight_m)
            if (lean2 := forward**2 + right**2) > _HARD_LEAN**2:
                across_m2 = across_m2 + lean2 * np.outer(sight_m, sight_m)
            across_m2[2, 2] += (_STRETCHED * sight_m[2]) ** 2
            covariance = covariance + off_rad**2 * across_m2
        if motion.agl_m < _TELLS_FROM_M:
            climbs_m = _BLURRED_CLIMB_M_S * (motion.t1_s - motion.t0_s)
            covariance = covariance + np.diag([0.0, 0.0, climbs_m * climbs_m])  # never raises
        return Displacement(motion.t1_s, replace(motion, covariance_ned_m2=covariance))

    def admit(
        self, motion: OdometryMotion, event: Displacement, timeline: _History
    ) -> Displacement | Verdict:
        """What may meet the filter of a way, whose keyframe is cloned from now on; or why not.

        `event` is the `displacement` of `motion`.
        """
        if motion.agl_m < _TELLS_FROM_M and timeline.newest.t_last_fix_s is None:
            return Verdict.ON_GROUND  # a take-off is broken off for ways that contradict the IMU
        way_m = float(np.hypot(*motion.displacement_ned_m[:2]))
        way_m *= max(timeline.newest.agl_m, 0.0) / motion.agl_m
        if not way_m < _NOISE_M + self._config.most_speed_m_s * (motion.t1_s - motion.t0_s):
            return Verdict.IMPOSSIBLE  # no aircraft flies so far, at the height that is believed
        before, self._newest = self._newest, motion
        may_zoom = motion.t1_s > self._zoomed_s + _ZOOMED_AGAIN_S
        if may_zoom and zoomed(before, motion, timeline.newest):
            self._zoomed_s = motion.t1_s
            timeline.insert(CameraReturned(motion.t1_s))
            return Verdict.IMPOSSIBLE
        known = timeline.keyframe_known(motion.t0_s)
        if not known and motion.t0_s < timeline.oldest.t_s:
            if before is None or not before.t0_s == motion.t0_s < before.t1_s < motion.t1_s:
                return Verdict.NO_ANCHOR
            event = self.displacement(between(before, motion))
            known = timeline.keyframe_known(event.motion.t0_s)
        refused = {event.motion.t0_s, motion.t1_s} & self._attitudes.refused_s
        unseen = not known and self._attitudes.at(event.motion.t0_s) is None
        if refused or unseen or self._attitudes.at(motion.t1_s) is None:
            return Verdict.NO_ATTITUDE
        if not (known or self._cloned(event.motion, timeline)):
            return Verdict.NO_ANCHOR
        heard = event.t_s <= self._attitudes.gyro.newest_s + _IMU_OF_NOW_S
        if not (heard or self._turned):
            self.trust_all()
        share = min((motion.t1_s - before.t1_s) / _APART_S, 1.0) if before is not None else 0.0
        # Images of one keyframe share its attitude's error: a hover on one says it at each.
        keyframe_s, said = self._by_keyframe
        said = said if motion.t0_s == keyframe_s else 0.0
        told = share * min(max(motion.tilts_along, -_MOST_ALONG), _MOST_ALONG)
        says = min(max(said + told, -_MOST_ALONG), _MOST_ALONG)
        self._by_keyframe = (motion.t0_s, says)
        self._along = min(max(self._along + says - said, -_SURE_ALONG), 2.0 * _SURE_ALONG)
        self._turned = self._along == -_SURE_ALONG
        return event

    def _cloned(self, motion: OdometryMotion, timeline: _History) -> bool:
        """Whether its keyframe's pose is cloned now."""
        share = self._config.anchor_share
        covariance, yaw_rad = share * motion.covariance_ned_m2, share**0.5 * motion.sigma_yaw_rad
        return timeline.insert(NewKeyframe(motion.t0_s, covariance, yaw_rad)).accepted

    def forgive(self) -> None:
        """Count anew: what was refused was right, or is of before."""
        self._seen.clear()
        self._begun_s = math.inf

    @property
    def words(self) -> str:
        """What a change has come to."""
        if self.lens_doubted:
            return _LENS_DOUBTED
        return _CONTRADICTS if self.lost else _AGREES

    def learn(self, told: Innovation, motion: OdometryMotion, state: FilterState) -> bool:
        """Whether a way has made a change of `lost`.

        Args:
            told: what the filter said of it.
            motion: the way.
            state: the filter's, at the way's end.
        """
        t_s, self._in_scale = state.t_s, self._in_scale or self.fixes > 0
        agrees = told.verdict is Verdict.FUSED
        window_s = self._agree_s if self.lost else _WINDOW_S
        if self._seen and t_s - self._seen[-1].t_s > _GAP_S:
            self.forgive()
        if self.lost:
            self._dates.see(motion, self._imu.until(motion.t1_s), state)
            if told.verdict is Verdict.GATED:
                self._dates.refused()
        self._seen.append(_Way(t_s, agrees, agrees and (told.nis or 0.0) <= _NEAR_NIS))
        self._begun_s = min(self._begun_s, t_s)
        self.believed_s = min(self.believed_s, t_s)
        while self._seen[0].t_s < t_s - window_s:
            self._seen.popleft()
        few = len(self._seen) < _LEAST or t_s - self._begun_s < window_s
        if few and (self.lost or not self._turned):
            return False
        share, near = np.mean([way[1:] for way in self._seen], axis=0).tolist()
        doubted = _DOUBTED if len(state.rejected_fixes) < _UNBORNE else _DOUBTED_UNBORNE
        if near <= _DOUBTED:  # those that agree do hardly
            doubted = max(doubted, _DOUBTED_HARDLY)
        proven = self.fixes > 0 and self._along >= 0.0 and self._dates.are_right(t_s - window_s)
        if self.lost and proven and share >= _TRUSTED:
            self.lost, self.believed_s, self.fixes = False, t_s, 0
        elif not self.lost and (share <= doubted or self._turned):
            can_be = not (self.lens_doubted or self._in_scale)
            self.lens_doubted = can_be and may_be_the_lens(state, self._along)
            if self.lens_doubted:
                self.trust_all()
                return True
            again = t_s - self._lost_s < _FORGIVEN_S
            self._agree_s = _LONGER * self._agree_s if again else _AGREE_S
            self.lost, self.borne, self.fixes = True, self.fixes >= _BEARING, 0
            self._dates.forget()
        else:
            return False
        self._lost_s = t_s
        self.forgive()
        return True


class MountCheck:
    """How the camera is turned on its mount, which images tell alone.

    Whenever the aircraft tilts they show it tilt, about an axis that is turned by as much. With w
    the turn that the attitudes tell, z what an image shows and V its variance, the likelihood of a
    camera turned by a, N(z; Rz(-a) w, V), is largest at a = atan2(S, C), C = sum z.w / V,
    S = sum z x w / V (the mean direction of von Mises' distribution).
    """

    def __init__(self, is_open: bool, attitudes: AttitudeHistory) -> None:
        """`is_open`: it has to be asked. `attitudes` as they are believed."""
        self._is_open = is_open
        self._turns, self._distrusted = 0, False
        self._knocks = KnockCheck(attitudes)
        self._seen_s = self._broke_s = self._back_s = -math.inf  # image: any; lost; first again
        self._tilts = np.zeros((2, 6))  # from the start, and since it broke: sums, as `hangs` asks
        self._tilted_s = math.inf
        self._keyframe_s, self._left = -math.inf, _MOST_OF_ONE

    def redated(self) -> None:
        """Images of other moments than they said tilted this way and that."""
        self._tilts[:] = 0.0

    def broke(self, t_s: float) -> None:
        """An image could not be followed: the camera may hang otherwise, or be another if gone."""
        if t_s - self._seen_s > CAMERA_GONE_S:
            self._back_s = t_s
        self._seen_s = self._broke_s = t_s
        self._tilts[1] = 0.0

    def turned(
        self, motion: OdometryMotion, told: Innovation, had_fix: bool, borne_s: float = -math.inf
    ) -> Recalibrated | None:
        """How it is known to be turned, with one more image; None while it is not, or as told.

        Pictures of another moment tilt this way and that: those are asked that are believed. That
        they are mirrored is why none is, perhaps.

        Args:
            motion: by which it moved.
            told: what the filter said of that, the heading first.
            had_fix: a map fix has been believed.
            borne_s: the newest whose heading was: what broke before has not knocked the camera.
        """
        self._seen_s = motion.t1_s
        if borne_s > self._broke_s:
            self._broke_s, self._tilts[1] = -math.inf, 0.0
        if not self._is_open or self._turns == _MOST_TURNS:
            return None
        agrees = {told.verdict, *map(_VERDICT, told.parts)} == {Verdict.FUSED}
        asked = self._knocks.knock is not None or not agrees
        found = self._knocks.turned(motion, told) if asked else None
        tilts = motion.tilts_turned
        tells = told.verdict in _JUDGED and motion.agl_m >= _TELLS_FROM_M
        if found is None and tells and tilts is not None:
            distrusted = told.verdict is Verdict.DISTRUSTED
            if self._distrusted and not distrusted:
                self._tilts[:] = 0.0
            self._distrusted = distrusted
            found = self._tilted(motion, tilts, had_fix)
            if distrusted and found is not None and not found.mirrored:
                return None
        if found is not None:
            self._tilts[:] = 0.0
            self._turns += 1
        return found

    def _tilted(self, motion: OdometryMotion, tilts: Array, had_fix: bool) -> Recalibrated | None:
        """How images tilt otherwise than the aircraft, `tilts` (5,) as odometry has it."""
        quarter, half, three = tilts[:3].tolist()
        tilted = -(motion.tilts_along + half)
        along = tilted + (0.5 * (motion.tilts_along - half) - tilted) / OVERSTATED
        across = 0.5 * (quarter - three) / OVERSTATED
        mirrored = (tilts[3:] + 0.5 * tilted) / OVERSTATED
        weight = min(_MOST_TOLD / max(math.hypot(along, across), 1e-9), 1.0)
        if motion.t0_s != self._keyframe_s:
            self._keyframe_s, self._left = motion.t0_s, _MOST_OF_ONE
        since_s, most = max(motion.t1_s - self._tilted_s, 0.0), np.minimum(_MOST_SHARE, self._left)
        share = np.minimum(since_s / _APART_S, most)
        self._tilted_s, self._left = motion.t1_s, self._left - share
        said = weight * np.array([along, across, *mirrored, tilted])
        self._tilts += np.outer(share, [*said, _APART_S])
        is_fresh = had_fix and motion.t1_s < self._broke_s + _FRESH_S
        for knocked in (True, False) if is_fresh else (False,):
            along, across, *mirrored, told, _ = sums = self._tilts[int(knocked)].tolist()
            stated = along - told * (1.0 - 1.0 / OVERSTATED)
            likelier = math.hypot(*mirrored) - math.hypot(stated, across)
            since_s, again = self._broke_s if knocked else motion.t1_s, self._turns > 0
            sure = max(math.hypot(along, across) - along, likelier) >= LEAST_SURE
            is_new = motion.t1_s < self._back_s + _FRESH_S  # its driver may have begun anew
            found = hangs(sums, since_s, knocked, had_fix, again, is_new) if sure else None
            if found is not None:
                return found
        return None

"""What `vwnav replay` does, once its options are read."""

import math
import time
from bisect import bisect_left
from collections import deque
from contextlib import closing
from pathlib import Path

import cv2

from vwnav.assemble import Assembled, about_run, assemble, choose_features, with_map
from vwnav.cameras.sources import open_source
from vwnav.config import load_config, save_config, with_camera, with_features
from vwnav.errors import SourceError, VwnavError
from vwnav.estimation.events import Untracked
from vwnav.geometry.calibration import load_camera
from vwnav.geometry.camera import Camera, check_fits
from vwnav.geometry.geodesy import LocalFrame
from vwnav.maps.pack import MapPack
from vwnav.offline.report import ReplayOptions, ReplayRecord, Tally, no_halves
from vwnav.pipeline import Pipeline
from vwnav.recording.input_log import InputLog
from vwnav.recording.recorder import Recorder
from vwnav.recording.run_folder import make_run_folder
from vwnav.recording.telemetry_files import load_telemetry
from vwnav.safety.camera_watch import Repeats
from vwnav.screen import LiveLine, say
from vwnav.seams import ATTITUDE_WAIT_S, FrameSource, InlineExecutor, StepResult
from vwnav.types import Attitude, Frame, Rejected, RejectReason, Telemetry

DEFAULT_HFOV_DEG = 70.0  # an action or phone camera; only the height depends on it
LEAD_S = 1.0  # of the telemetry before the first image
_STALLED_S = 0.3  # a frame rate that was changed repeats single images


def replay_source(options: ReplayOptions) -> None:
    """Run the pipeline over a recording and write the run folder.

    Raises:
        VwnavError: anything a person can mend; also when no image was located.
        OSError: there is no room for what it writes.
    """
    cv2.setNumThreads(1)  # the same recording gives the same trajectory
    config = with_features(load_config(options.config_path), options.features, options.model)
    with MapPack.open(options.map_path) as pack:
        log = load_telemetry(options.telemetry) if options.telemetry else None
        source = open_source(options.source)
        try:
            first = source.next_frame()
            if first is None:
                raise SourceError(f"{options.source} holds no picture")
            told = log.measurements(first.t_s) if log is not None else []
            alone = _is_alone(told)
            height_px, width_px = first.image.shape[:2]
            camera = choose_camera(options.camera, options.hfov_deg, width_px, height_px)
            local_frame = LocalFrame(*pack.middle, 0.0)
            config = with_camera(
                config, camera.sigma_mount_rad, camera.sigma_focal_ratio, camera.sigma_time_offset_s
            )
            config = with_map(config, pack)
            if alone:
                config = config.model_copy(update={"ekf": config.ekf.without_telemetry()})
            assembled = assemble(
                *choose_features(config.features, say),
                pack,
                camera,
                local_frame,
                config,
                InlineExecutor(),
                say,
            )
            folder = make_run_folder(options.output, "replay")
            save_config(config, folder / "config.toml")
            about = about_run(assembled, config.features.name, "center" if alone else "nadir")
            settings = config.model_dump(mode="json")
            with (
                no_halves(folder, "config.toml", "flight.mcap"),
                closing(Recorder(folder / "flight.mcap", settings)) as recorder,
            ):
                input_log = InputLog(recorder, about)
                assembled.ekf.record(input_log.input)
                _run(options, folder, source, first, told, assembled, input_log)
        finally:
            source.close()


def choose_camera(
    calibration: Path | None, hfov_deg: float | None, width_px: int, height_px: int
) -> Camera:
    """The calibrated camera, or a pinhole of the given field of view.

    Raises:
        VwnavError: the calibration is unreadable or for images of another size.
    """
    if calibration is not None:
        camera = load_camera(calibration)
        check_fits(camera, width_px, height_px)
        return camera
    if hfov_deg is None:
        say(
            f"no --camera and no --hfov-deg: taking {DEFAULT_HFOV_DEG:.0f} degrees; "
            "positions do not depend on it, heights do"
        )
        hfov_deg = DEFAULT_HFOV_DEG
    return Camera.from_hfov(width_px, height_px, hfov_deg)


def _run(
    options: ReplayOptions,
    folder: Path,
    source: FrameSource,
    first: Frame,
    told: list[Telemetry],
    assembled: Assembled,
    input_log: InputLog,
) -> None:
    record = ReplayRecord(folder, input_log.about, assembled.pack, first.t_s)
    tally = record.tally
    trouble: VwnavError | None = None
    frame: Frame | None = first
    images = _Images(assembled.pipeline, _is_alone(told))
    attitudes = _AttitudesTold(told, first.t_s)
    coming = deque(seen for seen in told if seen.t_s > first.t_s - LEAD_S)
    with LiveLine() as line:
        while frame is not None:
            start_s = time.perf_counter()
            _feed(assembled.pipeline, coming, frame.t_s)
            step = images.step(frame)
            tally.busy_s += time.perf_counter() - start_s
            attitudes.look(frame.t_s)
            input_log.image(step, None)
            record.add(step, None)
            line.show(frame.t_s, _status(tally, frame.t_s - first.t_s))
            try:
                frame = source.next_frame()
            except SourceError as error:
                trouble, frame = error, None
    record.close()
    record.summarise(options, {})
    if trouble is not None:
        raise SourceError(f"{trouble}; the {tally.frames} pictures before it are in {folder}")
    if attitudes.lacking:
        lacking = f"{options.telemetry} {attitudes.complaint(tally.frames)}"
        if not tally.fixes:
            raise VwnavError(f"no picture was located: {lacking}")
        say(lacking)
    if not tally.fixes:
        why = ", ".join(f"{n} {reason}" for reason, n in tally.rejected.most_common(3))
        raise VwnavError(
            f"none of {tally.frames} pictures was located ({why}): does the map show this place?"
        )


class _AttitudesTold:
    """Which images the telemetry's attitudes are about.

    Attributes:
        lacking: of how many images none is told, a second before and after them.
    """

    def __init__(self, told: list[Telemetry], first_image_s: float) -> None:
        self._times_s = [seen.t_s for seen in told if isinstance(seen, Attitude)]
        self._first_image_s = self._image_s = first_image_s
        self.lacking = 0

    def look(self, t_s: float) -> None:
        """The next image; where no attitude at all is told, none is lacking."""
        self._image_s = t_s
        near = self._times_s[max(bisect_left(self._times_s, t_s) - 1, 0) :][:2]
        self.lacking += bool(near) and min(abs(t_s - each) for each in near) > LEAD_S

    def complaint(self, images: int) -> str:
        """Of how many images they are lacking, and the times that may be why."""
        begin_s, end_s, last_s = (
            t_s - self._first_image_s
            for t_s in (self._times_s[0], self._times_s[-1], self._image_s)
        )
        return (
            f"tells no attitude of {self.lacking} of {images} pictures: it goes from {begin_s:.1f} "
            f"to {end_s:.1f} s, the pictures from 0 to {last_s:.1f} s; are its times in seconds "
            "from the first picture on?"
        )


class _Images:
    """Hands the images on; one that was there before tells nothing: its recording had stalled."""

    def __init__(self, pipeline: Pipeline, alone: bool) -> None:
        self._pipeline, self._alone = pipeline, alone
        self._repeats, self._new_s = Repeats(), -math.inf

    def step(self, frame: Frame) -> StepResult:
        if not self._repeats.look(frame.image):
            self._new_s = frame.t_s
            return self._pipeline.step(frame)
        if self._alone and frame.t_s - self._new_s > _STALLED_S:
            self._pipeline.feed(Untracked(frame.t_s))
        nothing = Rejected(frame.t_s, RejectReason.NOT_TRIED, "a picture that was there before")
        return StepResult(frame.t_s, nothing, nothing, self._pipeline.estimate(frame.t_s))


def _is_alone(told: list[Telemetry]) -> bool:
    """Nothing tells the attitude but the images."""
    return not any(isinstance(seen, Attitude) for seen in told)


def _feed(pipeline: Pipeline, coming: deque[Telemetry], t_s: float) -> None:
    """Hand in what was measured until an image, and on until its attitude is known."""
    while coming and coming[0].t_s <= t_s + ATTITUDE_WAIT_S:
        if coming[0].t_s > t_s and pipeline.covers(t_s):
            return
        pipeline.feed(coming.popleft())


def _status(tally: Tally, t_s: float) -> str:
    return (
        f"{t_s:6.1f} s  frame {tally.frames}  fixes {tally.fixes}/{tally.attempts}  "
        f"{tally.frames_per_s:.0f} frames/s"
    )

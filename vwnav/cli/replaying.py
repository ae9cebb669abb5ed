"""What `vwnav replay` does, once its options are read."""

import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import cv2

from vwnav import __version__
from vwnav.cli.assemble import Assembled, assemble
from vwnav.cli.screen import LiveLine, print_table, say
from vwnav.config import load_config, save_config
from vwnav.drivers.cameras import open_source
from vwnav.drivers.run_folder import TrajectoryWriter, make_run_folder, write_json
from vwnav.drivers.telemetry_files import Telemetry, load_telemetry
from vwnav.drivers.track_picture import TrackPicture
from vwnav.errors import SourceError, VwnavError
from vwnav.geometry.calibration import check_fits, load_camera
from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.maps.pack import MapPack
from vwnav.pipeline import InlineExecutor, Sensors, StepResult
from vwnav.types import Frame, FrameSource, MapFix, Rejected, RejectReason

DEFAULT_HFOV_DEG = 70.0  # an action or phone camera; only the height depends on it
IMU_LEAD_S = 1.0  # of the IMU's samples before the first picture


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """The command line of `vwnav replay`."""

    source: str
    map_path: Path
    camera: Path | None
    hfov_deg: float | None
    telemetry: Path | None
    features: str
    model: Path | None
    config_path: Path | None
    output: Path | None


@dataclass
class Tally:
    """Counts over a replay."""

    frames: int = 0
    attempts: int = 0
    fixes: int = 0
    first_fix_t_s: float | None = None
    rejected: Counter[str] = field(default_factory=Counter)
    busy_s: float = 0.0

    def add(self, step: StepResult, t0_s: float) -> None:
        """Count one picture."""
        self.frames += 1
        match step.outcome:
            case MapFix() as fix:
                self.attempts += 1
                self.fixes += 1
                if self.first_fix_t_s is None:
                    self.first_fix_t_s = fix.t_s - t0_s
            case Rejected(reason=RejectReason.NOT_TRIED):
                pass
            case Rejected(reason=reason):
                self.attempts += 1
                self.rejected[reason.name.lower()] += 1

    @property
    def frames_per_s(self) -> float:
        """Pictures through the pipeline per second of its own time (decoding not counted)."""
        return self.frames / self.busy_s if self.busy_s > 0.0 else 0.0


def replay_source(options: ReplayOptions) -> None:
    """Run the pipeline over a recording and write the run folder.

    Raises:
        VwnavError: anything a person can mend; also when no picture was located.
    """
    cv2.setNumThreads(1)  # the same recording gives the same trajectory
    config = load_config(options.config_path)
    with MapPack.open(options.map_path) as pack:
        telemetry = load_telemetry(options.telemetry) if options.telemetry else None
        source = open_source(options.source)
        try:
            first = source.next_frame()
            if first is None:
                raise SourceError(f"{options.source} holds no picture")
            height_px, width_px = first.image.shape[:2]
            camera = choose_camera(options.camera, options.hfov_deg, width_px, height_px)
            local_frame = centre_of(pack)
            if telemetry is None:
                config = config.model_copy(update={"ekf": config.ekf.without_telemetry()})
            assembled = assemble(
                pack,
                camera,
                options.features,
                options.model,
                local_frame,
                config,
                InlineExecutor(),
                say,
            )
            folder = make_run_folder(options.output, "replay")
            save_config(config, folder / "config.toml")
            _run(options, folder, source, first, telemetry, assembled)
        finally:
            source.close()


def choose_camera(
    calibration: Path | None, hfov_deg: float | None, width_px: int, height_px: int
) -> Camera:
    """The calibrated camera, or a pinhole of the given field of view.

    Raises:
        VwnavError: the calibration is unreadable or for pictures of another size.
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
    return Camera.from_hfov(width_px, height_px, hfov_deg or DEFAULT_HFOV_DEG)


def centre_of(pack: MapPack) -> LocalFrame:
    """NED origin of a run that has no home: the middle of the map, at sea level."""
    south, west, north, east = pack.bounds
    return LocalFrame((south + north) / 2.0, (west + east) / 2.0, 0.0)


def _run(
    options: ReplayOptions,
    folder: Path,
    source: FrameSource,
    first: Frame,
    telemetry: Telemetry | None,
    assembled: Assembled,
) -> None:
    local_frame = assembled.pipeline.local_frame
    trajectory = TrajectoryWriter(folder / "trajectory.csv", local_frame, first.t_s)
    picture = TrackPicture(assembled.pack, local_frame)
    tally = Tally()
    trouble: VwnavError | None = None
    frame: Frame | None = first
    before_s = -IMU_LEAD_S
    with LiveLine() as line:
        while frame is not None:
            t_s = frame.t_s - first.t_s
            sensors = telemetry.at(t_s, before_s) if telemetry else Sensors()
            before_s = t_s
            start_s = time.perf_counter()
            step = assembled.pipeline.step(frame, sensors)
            tally.busy_s += time.perf_counter() - start_s
            tally.add(step, first.t_s)
            trajectory.write(step)
            picture.add(step)
            line.show(frame.t_s, _status(tally, frame.t_s - first.t_s))
            try:
                frame = source.next_frame()
            except SourceError as error:
                trouble, frame = error, None
    trajectory.close()
    picture.save(folder / "track.png")
    _summarise(options, folder, assembled, tally)
    if trouble is not None:
        raise SourceError(f"{trouble}; the {tally.frames} pictures before it are in {folder}")
    if not tally.fixes:
        why = ", ".join(f"{n} {reason}" for reason, n in tally.rejected.most_common(3))
        raise VwnavError(
            f"none of {tally.frames} pictures was located ({why}): does the map show this place?"
        )


def _status(tally: Tally, t_s: float) -> str:
    return (
        f"{t_s:6.1f} s  frame {tally.frames}  fixes {tally.fixes}/{tally.attempts}  "
        f"{tally.frames_per_s:.0f} frames/s"
    )


def _summarise(options: ReplayOptions, folder: Path, assembled: Assembled, tally: Tally) -> None:
    local_frame = assembled.pipeline.local_frame
    known = options.telemetry is not None
    write_json(
        folder / "run.json",
        {
            "command": "replay",
            "version": __version__,
            "source": Path(options.source).name,
            "map": options.map_path.name,
            "features": options.features,
            "feature_set_id": assembled.feature_set_id,
            "point": "nadir" if known else "center",
            "origin": {
                "lat_deg": local_frame.lat_deg,
                "lon_deg": local_frame.lon_deg,
                "alt_amsl_m": local_frame.alt_amsl_m,
            },
            "frames": tally.frames,
            "attempts": tally.attempts,
            "fixes": tally.fixes,
            "rejected": dict(tally.rejected),
            "first_fix_t_s": tally.first_fix_t_s,
            "frames_per_s": round(tally.frames_per_s, 1),
        },
    )
    rate = 100.0 * tally.fixes / tally.attempts if tally.attempts else 0.0
    first_fix = "none" if tally.first_fix_t_s is None else f"{tally.first_fix_t_s:.2f} s"
    print_table(
        "replay",
        [
            ("frames", str(tally.frames)),
            ("fixes of attempts", f"{tally.fixes} of {tally.attempts} ({rate:.1f} %)"),
            ("first fix at", first_fix),
            ("pipeline", f"{tally.frames_per_s:.1f} frames/s on one core"),
            ("results in", str(folder)),
        ],
    )

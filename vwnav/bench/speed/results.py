"""What is asked of the bench, and the figures that it brings."""

from dataclasses import dataclass

from vwnav.bench.speed.accuracy import Accuracy
from vwnav.bench.speed.settings import Setting
from vwnav.safety.check import Check


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What is asked for.

    Attributes:
        features: names or model files; all where empty.
        threads: of an extraction, at most; all but one core where None.
        target_hz: images to be matched to the map a second.
        repeats: images of each setting.
        seconds: in real time, of what is chosen.
    """

    features: list[str]
    threads: int | None
    target_hz: float
    repeats: int
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StepTime:
    """Milliseconds of one image: by the clock, but for `cpu_ms`.

    Attributes:
        p50_ms, p99_ms: of all of it; of few images the latter is the slowest one.
        cpu_ms: processor time of all threads, mean.
        rectify_ms, extract_ms, match_ms, verify_ms: medians; the map is read in `match_ms`.
        placed: share of the images that gave a fix.
    """

    p50_ms: float
    p99_ms: float
    cpu_ms: float
    rectify_ms: float
    extract_ms: float
    match_ms: float
    verify_ms: float
    placed: float

    @property
    def rate_hz(self) -> float:
        """Steps a second, one after the other."""
        return 1e3 / self.p50_ms


@dataclass(frozen=True, slots=True, kw_only=True)
class TimedSetting:
    """A setting with its time here, and its accuracy as it was measured elsewhere."""

    setting: Setting
    feature_set_id: str
    time: StepTime
    accuracy: Accuracy | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Latency:
    """What a flight with a setting would have here.

    Attributes:
        seconds: how long it was looked at.
        rate_hz: images matched to the map a second.
        fixes: how many of them gave one.
        p50_ms, p99_ms: from the exposure of an image to the first estimate with its fix in it,
            as the link sends it; the camera's own delay comes on top. None without a fix.
        link_gap_ms: longest time between two estimates, of which 50 a second are wanted.
        cores: that all of it kept busy.
    """

    seconds: float
    rate_hz: float
    fixes: int
    p50_ms: float | None
    p99_ms: float | None
    link_gap_ms: float
    cores: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RealTimeRun:
    """A setting in real time."""

    timed: TimedSetting
    latency: Latency


@dataclass(frozen=True, slots=True, kw_only=True)
class Projection:
    """The network alone, without the step around it.

    Attributes:
        gmac: thousand millions of multiply-accumulates on an image.
        ms: by name of the board.
    """

    model: str
    size: str
    is_int8: bool
    gmac: float
    ms: dict[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedReport:
    """Everything that was measured.

    Attributes:
        tried: in real time, the most accurate first.
        chosen: of these; None where nothing holds the rate.
        projected: for boards that this one is not.
        before, after: what makes a board slow, before and after the load.
        skipped: one line for each thing that was left out.
    """

    wanted: Wanted
    machine: str
    cores: int
    rows: list[TimedSetting]
    tried: list[RealTimeRun]
    chosen: RealTimeRun | None
    projected: list[Projection]
    before: list[Check]
    after: list[Check]
    skipped: list[str]

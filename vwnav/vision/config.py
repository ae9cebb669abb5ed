"""Settings of the features, of the localizer and of visual odometry."""

import math
from dataclasses import dataclass

from vwnav.types import FeatureName


@dataclass(frozen=True, slots=True, kw_only=True)
class FeaturesConfig:
    """What looks at images, where the command line says nothing else.

    Attributes:
        name: of the feature set.
        model: of the learned ones: a released name, or an ONNX file.
        threads: cores that one extraction by a model may use; the features are the same.
    """

    name: FeatureName = "learned"
    model: str = "default"
    threads: int = 1

    def __post_init__(self) -> None:
        if self.threads < 1:
            raise ValueError(f"expected one thread or more, got {self.threads}")


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizerConfig:
    """How images are located.

    Attributes:
        max_keypoints: of a view.
        max_view_area_px: of a view; decides, with the height, which level of the map is used.
        max_guesses: headings and heights tried when a rough prior fails.
        threshold_px: largest error of an inlier, map pixels.
        min_decades: unrelated images may give a fix once in ten to this power.
        min_contrast: standard deviation of the gray values below which an image is dark.
        search_agl_m: heights above ground that are tried when nothing is known of it.
        sigma_tilt_rad: of roll and pitch, when they are known.
        max_sigma_m: a fix that is less certain than this is none.
        max_track_radius_px: a prior that is wider than this on the map is searched coarse first.
    """

    max_keypoints: int = 1000
    max_view_area_px: float = 300_000.0
    max_guesses: int = 9
    threshold_px: float = 3.0
    min_decades: float = 5.0
    min_contrast: float = 2.5
    search_agl_m: tuple[float, float] = (20.0, 600.0)
    sigma_tilt_rad: float = math.radians(2.0)
    max_sigma_m: float = 20.0
    max_track_radius_px: float = 1500.0


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryConfig:
    """Sizes in pixels are of the reduced image."""

    widest_px: int = 480  # images are reduced to at most this width
    cell_px: int = 20  # one corner from each cell
    threshold_px: float = 2.5  # a track further off the ground plane is an outlier
    sigma_px: float = 0.55  # of a track: what it shares with its neighbours (rolling shutter, lens)
    least_contrast: float = 2.0  # standard deviation of gray levels, of 255
    least_corners: int = 20
    least_inliers: int = 12
    least_inlier_ratio: float = 0.3
    most_sigma_ratio: float = 0.1  # of the way, in AGL: beyond it the points hang together badly
    # When a keyframe has served
    keep_ratio: float = 0.5  # of its corners still seen
    keep_turn_rad: float = math.radians(8.0)  # Lucas-Kanade does not turn its windows
    keep_zoom: float = 0.12  # nor does it scale them: relative change of height
    # What attitudes leave open
    tilt_increment_rad: float = math.radians(0.2)  # between keyframe and image
    # Of the attitude, fixed to the body: in a turn it changes by as much of itself. The less of
    # that is allowed for, the larger a share of it is taken for motion.
    tilt_rad: float = math.radians(2.0)
    tilt_increment_level_rad: float = math.radians(2.0)  # of a video alone
    yaw_sigma_rad: float = 0.003  # what a shared tilt error does to a change of heading
    slope: float = 0.1  # of the ground, with the attitude's own error
    slope_level: float = 0.09  # of a video alone
    slope_change: float = 0.05  # from what the keyframe before has shown
    bend: float = 0.045  # of the ground: as high as that, in heights, where seen at 45 degrees
    least_agl_m: float = 0.3

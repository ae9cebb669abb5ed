"""Settings of the features, of the localizer and of visual odometry."""

import math
from dataclasses import dataclass
from typing import Annotated

from vwnav.settings.ranges import Angle, Count, NotNegative, Positive, Settings, Share, Within
from vwnav.types import FeatureName


@dataclass(frozen=True, slots=True, kw_only=True)
class FeaturesConfig(Settings):
    """What looks at images, where the command line says nothing else.

    Attributes:
        name: of the feature set.
        model: of the learned ones: a released name, or an ONNX file.
        threads: cores that one extraction by a model may use; the features are the same.
    """

    name: FeatureName = "learned"
    model: str = "default"
    threads: Annotated[int, Within(1, 1024)] = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizerConfig(Settings):
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
        max_sigma_m: a fix whose matches leave it less certain than this is none.
        max_track_radius_px: a prior that is wider than this on the map is searched coarse first.
    """

    max_keypoints: Annotated[int, Within(1, 20000)] = 1000
    max_view_area_px: Annotated[float, Within(1e3, 1e8)] = 300_000.0
    max_guesses: Annotated[int, Within(1, 1000)] = 9
    threshold_px: Annotated[float, Within(0.0, 100.0, above=True)] = 3.0
    min_decades: Annotated[float, Within(0.0, 100.0)] = 5.0
    min_contrast: Annotated[float, Within(0.0, 255.0)] = 2.5
    search_agl_m: Annotated[tuple[float, float], Within(0.0, 1e4, above=True)] = (20.0, 600.0)
    sigma_tilt_rad: Angle = math.radians(2.0)
    max_sigma_m: Annotated[float, Within(0.0, 1000.0, above=True)] = 20.0
    max_track_radius_px: Annotated[float, Within(0.0, 1e6, above=True)] = 1500.0


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryConfig(Settings):
    """Sizes in pixels are of the reduced image."""

    widest_px: Annotated[int, Within(16, 10000)] = 480  # images are reduced to at most this width
    cell_px: Annotated[int, Within(1, 10000)] = 20  # one corner from each cell
    # A track further off the ground plane is an outlier
    threshold_px: Annotated[float, Within(0.0, 100.0, above=True)] = 2.5
    # Of a track: what it shares with its neighbours (rolling shutter, lens)
    sigma_px: Annotated[float, Within(0.0, 100.0, above=True)] = 0.55
    # Standard deviation of gray levels, of 255
    least_contrast: Annotated[float, Within(0.0, 255.0)] = 2.0
    least_corners: Count = 20
    least_inliers: Count = 12
    least_inlier_ratio: Share = 0.3
    most_sigma_ratio: Positive = 0.1  # of the way, in AGL: beyond it the points hang together badly
    # When a keyframe has served
    keep_ratio: Share = 0.5  # of its corners still seen
    keep_turn_rad: Angle = math.radians(8.0)  # Lucas-Kanade does not turn its windows
    keep_zoom: Positive = 0.12  # nor does it scale them: relative change of height
    # What attitudes leave open
    tilt_increment_rad: Angle = math.radians(0.2)  # between keyframe and image
    # Of the attitude, fixed to the body: in a turn it changes by as much of itself. The less of
    # that is allowed for, the larger a share of it is taken for motion.
    tilt_rad: Angle = math.radians(2.0)
    tilt_increment_level_rad: Angle = math.radians(2.0)  # of a video alone
    yaw_sigma_rad: Angle = 0.003  # what a shared tilt error does to a change of heading
    slope: NotNegative = 0.1  # of the ground, with the attitude's own error
    slope_level: NotNegative = 0.09  # of a video alone
    slope_change: NotNegative = 0.05  # from what the keyframe before has shown
    # Of the ground: as high as that, in heights, where seen at 45 degrees
    bend: NotNegative = 0.045
    least_agl_m: Positive = 0.3

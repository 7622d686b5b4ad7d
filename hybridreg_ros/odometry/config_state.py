# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Config sections of what the front end remembers and reports: keyframes, loss, movers."""

from __future__ import annotations

from dataclasses import dataclass

from hybridreg_ros.core.config import option, validate


class Section:
    """A config section that checks itself."""

    def __post_init__(self) -> None:
        """Check types and ranges.

        Raises:
            ConfigError: a value has the wrong type or lies outside its range.
        """
        validate(self)


@dataclass(frozen=True)
class KeyframeConfig(Section):
    """When a scan becomes a keyframe and which ones are kept."""

    min_overlap: float = option(
        0.7, 'a scan overlapping the keyframe less becomes the next one', low=0.0, high=1.0
    )
    max_distance: float = option(
        20.0,
        'so many voxels from the keyframe, a scan becomes the next one',
        low=0.1,
        high=10_000.0,
    )
    max_angle_deg: float = option(
        20.0,
        'turned by so much from the keyframe, a scan becomes the next one',
        low=1.0,
        high=180.0,
    )
    max_age_s: float = option(
        10.0, 'a scan so much later becomes the next keyframe, seconds', low=0.1, high=3600.0
    )
    window: int = option(3, 'recent keyframes a scan may be matched against', low=1, high=20)
    memory: int = option(30, 'keyframes kept for relocalisation', low=1, high=1000)


@dataclass(frozen=True)
class LostConfig(Section):
    """When the front end gives up a pose, and how it comes back."""

    after_bad_frames: int = option(3, 'so many bad frames in a row are LOST', low=1, high=100)
    reanchor_after: int = option(
        10, 'so many LOST scans in a row start a new map at the last pose', low=1, high=10_000
    )
    keyframes_tried: int = option(
        5, 'keyframes tried per scan while lost, nearest first', low=1, high=100
    )


@dataclass(frozen=True)
class CovarianceConfig(Section):
    """Pose and twist covariance."""

    scale: float = option(
        0.0, 'factor on the inverse information; 0 = as fitted on simulated sequences',
        low=0.0, high=1e6,
    )  # fmt: skip
    fallback_factor: float = option(
        1.5, 'extra factor while the fallback makes the pose', low=1.0, high=1e6
    )
    coast_factor: float = option(
        100.0, 'extra factor per frame whose pose is only predicted', low=1.0, high=1e6
    )


@dataclass(frozen=True)
class DynamicsConfig(Section):
    """Which points move."""

    enabled: bool = option(True, 'estimate P(dynamic) per point and keep movers out of the map')
    threshold: float = option(
        0.5, 'points above this P(dynamic) are published as dynamic', low=0.0, high=1.0
    )
    memory: int = option(8, 'earlier scans a point is compared with', low=1, high=50)
    spacing_s: float = option(
        0.5, 'time between the scans that are kept for that once there are enough, seconds',
        low=0.0, high=10.0,
    )  # fmt: skip
    cell: float = option(1.0, 'edge of the cells that are judged, in voxels', low=0.25, high=10.0)
    enter_share: float = option(
        0.5, 'share of the looks at a place that saw it free, for its points to count as moving',
        low=0.0, high=1.0,
    )  # fmt: skip
    stay_share: float = option(
        0.15, 'the same for points that counted as moving in the last scan', low=0.0, high=1.0
    )
    growth: int = option(5, 'cells that motion spreads over connected points', low=0, high=100)
    growth_share: float = option(
        1.0, 'cells a group may grow by, per cell in space seen free', low=0.0, high=100.0
    )
    fade: float = option(0.97, 'factor on P(dynamic) per such cell', low=0.0, high=1.0)
    bend_deg: float = option(
        15.0, 'neighbouring cells of one surface turn by less, degrees', low=1.0, high=90.0
    )
    fold: float = option(
        0.25, 'a fold inwards by more (difference of sines) divides two things', low=0.0, high=2.0
    )
    surface_cells: int = option(
        60, 'motion does not spread over a still surface of more cells', low=1, high=100_000
    )
    surface_share: float = option(
        0.2, 'share of the cells seen before that came, for a surface to move as a whole',
        low=0.0, high=1.0,
    )  # fmt: skip
    object_share: float = option(
        0.3, 'the same for a thing made of several surfaces', low=0.0, high=1.0
    )
    min_object_cells: int = option(
        8, 'cells that came, for a thing to move as a whole', low=1, high=1000
    )
    min_seed_cells: int = option(
        5, 'groups with fewer cells in space seen free are taken as noise', low=0, high=1000
    )
    network_weight: float = option(
        0.4, "weight of the network's uncertainty where the scene was seen before",
        low=0.0, high=1.0,
    )  # fmt: skip
    tolerance: float = option(
        0.0,
        'slack in range before a point is off a seen surface, in voxels; 0 = by sensor (depth '
        '0.4, lidar 0.5)',
        low=0.0, high=10.0,
    )  # fmt: skip
    tolerance_share: float = option(
        0.0, 'further slack as a share of the range; 0 = by sensor (depth 0.0125, lidar 0.015)',
        low=0.0, high=0.5,
    )  # fmt: skip
    decay: float = option(0.8, 'share of the evidence that survives a frame', low=0.0, high=1.0)
    min_cluster_points: int = option(
        20, 'smaller groups of moving points are taken as noise', low=1, high=10_000
    )

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""OdometryConfig: every setting of the front end, with its description and range."""

from __future__ import annotations

from dataclasses import dataclass

from hybridreg_ros.core.config import dump_yaml, option, validate

__all__ = [
    'CovarianceConfig',
    'DynamicsConfig',
    'GateConfig',
    'InputConfig',
    'KeyframeConfig',
    'LostConfig',
    'MapConfig',
    'OdometryConfig',
    'PreprocessConfig',
    'parameter_file',
]


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
        0.7,
        'a new keyframe is made when a scan overlaps the current one by less than this share',
        low=0.0,
        high=1.0,
    )
    max_distance: float = option(
        20.0,
        'a new keyframe is made at this distance from the current one, in voxels',
        low=0.1,
        high=10_000.0,
    )
    max_angle_deg: float = option(
        20.0,
        'a new keyframe is made at this rotation from the current one, degrees',
        low=1.0,
        high=180.0,
    )
    max_age_s: float = option(
        10.0,
        'a new keyframe is made when the current one is this old, seconds',
        low=0.1,
        high=3600.0,
    )
    window: int = option(
        3, 'number of recent keyframes that a scan may be matched against', low=1, high=20
    )
    memory: int = option(30, 'number of keyframes kept for relocalisation', low=1, high=1000)


@dataclass(frozen=True)
class LostConfig(Section):
    """When a pose is given up, and how it is found again."""

    after_bad_frames: int = option(
        3, 'number of consecutive bad frames after which the pose counts as lost', low=1, high=100
    )
    reanchor_after_s: float = option(
        10.0,
        'time for which the pose is looked for in the old map before a new one is started at the '
        'last pose, seconds',
        low=0.0,
        high=1e6,
    )
    keyframes_tried: int = option(
        5, 'number of keyframes tried per scan while lost, nearest first', low=1, high=100
    )


@dataclass(frozen=True)
class CovarianceConfig(Section):
    """Pose and twist covariance."""

    scale: float = option(
        0.0,
        'factor on the inverse information matrix; 0 = the factor fitted on simulated sequences',
        low=0.0,
        high=1e6,
    )


@dataclass(frozen=True)
class DynamicsConfig(Section):
    """Which points move."""

    enabled: bool = option(
        True, 'estimate P(dynamic) per point and keep moving points out of the map'
    )
    threshold: float = option(
        0.5, 'points with at least this P(dynamic) are published as dynamic', low=0.0, high=1.0
    )


@dataclass(frozen=True)
class InputConfig(Section):
    """Which scans are accepted."""

    min_points: int = option(
        100,
        'a scan with fewer usable points (after range limits and thinning) is a bad frame',
        low=10,
        high=100_000,
    )
    max_gap_s: float = option(
        60.0,
        'a stamp that follows the last one later than this is taken for an error of the clock '
        'rather than for a pause, seconds',
        low=0.1,
        high=3600.0,
    )
    rebase_after: int = option(
        3,
        'number of consecutive scans on another time base after which it is accepted',
        low=1,
        high=1000,
    )


@dataclass(frozen=True)
class PreprocessConfig(Section):
    """From the sensor's cloud to the points that are registered."""

    min_range_m: float = option(
        0.0,
        'closer points are ignored, metres; 0 = by sensor (depth 0.2, lidar 0.5)',
        low=0.0,
        high=100.0,
    )
    max_range_m: float = option(
        0.0,
        'more distant points are ignored, metres; 0 = by sensor (depth 8, lidar 100)',
        low=0.0,
        high=1000.0,
    )
    max_points: int = option(
        400_000,
        'larger clouds are thinned to about this many points by taking every k-th one',
        low=1000,
        high=10_000_000,
    )
    deskew: bool = option(
        True, 'compensate for the motion during a scan if the points carry times'
    )
    intra_scan: bool = option(
        True,
        'estimate how that motion deviates from an even one, together with the pose, if the '
        'points carry times',
    )
    deskew_to: str = option(
        'stamp',
        'instant to which the pose of a deskewed scan refers: its stamp, its first or its '
        'last point',
        choices=('stamp', 'start', 'end'),
    )
    icp_thinning: float = option(
        1.5, 'edge length of the thinning cubes for registration, in voxels', low=0.5, high=8.0
    )


@dataclass(frozen=True)
class MapConfig(Section):
    """The local map."""

    reach_m: float = option(
        0.0,
        'points farther from the sensor are removed, metres; 0 = the maximum range',
        low=0.0,
        high=1000.0,
    )


@dataclass(frozen=True)
class GateConfig(Section):
    """Which poses are trusted, and which scans are written to the map."""

    sure: float = option(
        0.9,
        'confidence at which a pose needs no second opinion, and a scan is written to the map '
        'where the map already shows the place',
        low=0.0,
        high=1.0,
    )
    enter: float = option(
        0.7,
        'confidence below which the doubt of the network counts against its pose, and a pose does '
        'not move the motion model',
        low=0.0,
        high=1.0,
    )
    accept: float = option(
        0.3,
        'a pose of lower confidence makes a bad frame, and is used only where it agrees with '
        'the motion model; one of the network is not looked at',
        low=0.0,
        high=1.0,
    )


@dataclass(frozen=True)
class OdometryConfig(Section):
    """Settings of HybridOdometry."""

    registrar: str = option(
        'hybridreg',
        'which branch leads; kiss-icp never calls the network',
        choices=('hybridreg', 'kiss-icp'),
    )
    sensor: str = option(
        'auto',
        'kind of sensor; auto decides by the field of view of the first scan',
        choices=('auto', 'depth', 'lidar'),
    )
    voxel_size_m: float = option(
        0.0, 'voxel size of the map, metres; 0 = chosen from the first scan', low=0.0, high=10.0
    )
    input: InputConfig = option(InputConfig, 'which scans are accepted')
    preprocess: PreprocessConfig = option(
        PreprocessConfig, 'from the cloud to the registered points'
    )
    map: MapConfig = option(MapConfig, 'the local map')
    gate: GateConfig = option(GateConfig, 'which poses are trusted')
    keyframe: KeyframeConfig = option(KeyframeConfig, 'when a scan becomes a keyframe')
    lost: LostConfig = option(LostConfig, 'when a pose is given up and how it is found again')
    covariance: CovarianceConfig = option(CovarianceConfig, 'pose and twist covariance')
    dynamics: DynamicsConfig = option(DynamicsConfig, 'which points move')


def parameter_file(config: OdometryConfig | None = None) -> str:
    """ROS parameter file (YAML text) of a config, one comment per parameter.

    `config/odometry.yaml` is this text for the defaults; `core.config.load_yaml` reads it back.
    """
    head = (
        '# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers\n'
        '# SPDX-License-Identifier: Apache-2.0\n'
        '# Written by hybridreg_ros.odometry.config.parameter_file; a test keeps it up to date.\n'
        '/**:\n  ros__parameters:\n'
    )
    return head + dump_yaml(config or OdometryConfig(), indent=4)

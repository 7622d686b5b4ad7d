# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""OdometryConfig: every setting of the front end, with its description and range."""

from __future__ import annotations

from dataclasses import dataclass

from hybridreg_ros.core.config import dump_yaml, option, validate

__all__ = [
    'CovarianceConfig',
    'DynamicsConfig',
    'FallbackConfig',
    'GateConfig',
    'InputConfig',
    'KeyframeConfig',
    'LostConfig',
    'MapConfig',
    'OdometryConfig',
    'PreprocessConfig',
    'RefineConfig',
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


@dataclass(frozen=True)
class InputConfig(Section):
    """Which scans are taken."""

    min_points: int = option(
        100, 'scans with fewer usable points (after range limits and thinning) are bad frames',
        low=10, high=100_000,
    )  # fmt: skip
    max_gap_s: float = option(
        5.0, 'a stamp later than this after the last one is a jump, seconds', low=0.1, high=3600.0
    )
    rebase_after: int = option(
        3, 'so many consecutive scans on another time base and it is taken as the new one',
        low=1, high=1000,
    )  # fmt: skip


@dataclass(frozen=True)
class PreprocessConfig(Section):
    """From the sensor's cloud to the points that are registered."""

    min_range_m: float = option(
        0.0, 'nearer points are ignored, metres; 0 = by sensor (depth 0.2, lidar 0.5)',
        low=0.0, high=100.0,
    )  # fmt: skip
    max_range_m: float = option(
        0.0, 'farther points are ignored, metres; 0 = by sensor (depth 8, lidar 100)',
        low=0.0, high=1000.0,
    )  # fmt: skip
    max_points: int = option(
        400_000, 'larger clouds are thinned to about this many points by taking every k-th',
        low=1000, high=10_000_000,
    )  # fmt: skip
    deskew: bool = option(True, 'undo the motion during a scan when points carry times')
    deskew_to: str = option(
        'stamp',
        'instant of the pose of a deskewed scan: its stamp, or its first or last point',
        choices=('stamp', 'start', 'end'),
    )
    map_thinning: float = option(
        0.5, 'edge of the thinning cubes for the map, in voxels', low=0.1, high=4.0
    )
    icp_thinning: float = option(
        1.5, 'edge of the thinning cubes for registration, in voxels', low=0.5, high=8.0
    )
    icp_enough: int = option(
        0, 'where these cubes would leave fewer points, they are made finer, down to those of '
        'the map; 0 = by sensor (depth 4500, lidar 2500)', low=0, high=100_000,
    )  # fmt: skip
    icp_points: int = option(
        5000, 'most points that are registered; more are thinned by taking every k-th',
        low=200, high=100_000,
    )  # fmt: skip


@dataclass(frozen=True)
class MapConfig(Section):
    """The local map."""

    points_per_voxel: int = option(20, 'most points kept in one voxel', low=1, high=100)
    reach_m: float = option(
        0.0, 'points farther from the sensor are forgotten, metres; 0 = the maximum range',
        low=0.0, high=1000.0,
    )  # fmt: skip
    coarse_factor: float = option(
        8.0, 'voxels of the coarse level in fine ones', low=1.5, high=16.0
    )


@dataclass(frozen=True)
class RefineConfig(Section):
    """ICP against the local map."""

    max_iterations: int = option(15, 'most pairings per level', low=1, high=200)
    start_scale: float = option(
        0.5, 'robust scale on the coarse level at the start, in its voxels', low=0.0, high=2.0
    )
    anneal: float = option(
        0.6, 'factor by which the robust scale shrinks per pairing', low=0.01, high=1.0
    )
    convergence: float = option(
        0.005, 'a step below this many voxels ends the iteration', low=1e-6, high=0.5
    )
    coarse_points: int = option(1500, 'points used on the coarse level', low=100, high=100_000)
    min_scale: float = option(
        0.02, 'floor of the residual scale of the robust kernel, in voxels', low=1e-4, high=1.0
    )
    loose: float = option(
        0.02, 'share of what surfaces would hold if they faced every way that is taken for the '
        'error of their normals; directions that hold no more are left to the motion so far',
        low=0.0, high=1.0,
    )  # fmt: skip
    mature_s: float = option(
        0.5, 'a surface of the map counts fully once it has been seen for so long, seconds; 0 = '
        'all alike',
        low=0.0, high=100.0,
    )  # fmt: skip
    young: float = option(
        0.1, 'weight of a surface that was first seen in the last scan', low=0.0, high=1.0
    )
    intra_scan: bool = option(
        True, 'find the uneven motion during a scan along with its pose when points carry times'
    )
    intra_scan_iterations: int = option(6, 'most pairings for that', low=1, high=50)
    intra_scan_speed: float = option(
        0.12, 'standard deviation of the velocity off the predicted one, m/s', low=1e-3, high=100.0
    )
    intra_scan_turn_deg: float = option(
        3.0, 'the same of the angular velocity, degrees/s, before it is known how that varies',
        low=1e-2, high=1000.0,
    )  # fmt: skip
    intra_scan_follow: float = option(
        0.35, 'the same once that is known, as a share of its usual change from scan to scan; 0 = '
        'always as above',
        low=0.0, high=10.0,
    )  # fmt: skip


@dataclass(frozen=True)
class FallbackConfig(Section):
    """kiss-icp against the middle level of the map, from the constant-velocity guess."""

    max_iterations: int = option(100, 'most iterations of its registration', low=1, high=500)
    convergence: float = option(
        0.008, 'a step below this many of its voxels ends the iteration', low=1e-6, high=0.5
    )
    threads: int = option(1, 'threads of its registration', low=1, high=64)
    min_motion_m: float = option(
        0.0, 'deviations below this do not widen its threshold, metres; 0 = a tenth of its voxel',
        low=0.0, high=10.0,
    )  # fmt: skip
    initial_threshold_m: float = option(
        0.0, 'its first correspondence threshold, metres; 0 = two of its voxels',
        low=0.0, high=100.0,
    )  # fmt: skip
    thinning: float = option(
        1.5, 'edge of the thinning cubes for its points, in its voxels', low=0.1, high=8.0
    )
    max_points: int = option(2000, 'most points given to it', low=100, high=100_000)
    sure: float = option(
        0.95, 'confidence of the first guess from which no other is tried', low=0.0, high=1.0
    )
    good: float = option(0.9, 'the same once a second guess has been tried', low=0.0, high=1.0)
    accept: float = option(
        0.3, 'a pose of lower confidence counts as a bad frame, and is taken only where it is as '
        'the motion leads one to expect', low=0.0, high=1.0,
    )  # fmt: skip
    turns_deg: tuple[float, ...] = option(
        (20.0, 40.0, 60.0), 'turns of the guesses of a wide search, degrees', low=0.1, high=180.0
    )
    shifts: tuple[float, ...] = option(
        (1.0, 2.0, 3.0), 'shifts of the guesses of a wide search, in coarse voxels',
        low=0.1, high=100.0,
    )  # fmt: skip
    searched: int = option(
        3, 'guesses of a wide search that are followed up while in doubt', low=0, high=100
    )
    plane_icp: bool = option(
        True, 'refine its pose point to plane against the same map, as poses of the network are'
    )


@dataclass(frozen=True)
class GateConfig(Section):
    """When the network is asked and when its pose is trusted."""

    doubt: float = option(
        0.9,
        'share of the points standing on what an earlier scan saw, below which a pose gets a '
        'second opinion',
        low=0.0, high=1.0,
    )  # fmt: skip
    enter: float = option(
        0.7, 'confidence from which the network branch is taken up', low=0.0, high=1.0
    )
    write: float = option(
        0.9, 'a scan of lower confidence is not written to the map where the map shows it already',
        low=0.0, high=1.0,
    )  # fmt: skip
    firm: float = option(
        0.2, 'nor is a scan whose position is held more loosely than this along its worst '
        'direction, in voxels; neither of them becomes a keyframe',
        low=0.0, high=1000.0,
    )  # fmt: skip
    known: float = option(
        0.8, 'share of the points that find the map, from which it shows the scan already',
        low=0.0, high=1.0,
    )  # fmt: skip
    max_jump_m: float = option(
        0.0, 'largest disagreement with the predicted position, metres; 0 = by voxel and speed',
        low=0.0, high=1000.0,
    )  # fmt: skip
    against_motion: float = option(
        0.75, 'confidence that a pose farther off than that needs from what the scan sees',
        low=0.0, high=1.0,
    )  # fmt: skip
    max_jump_deg: float = option(
        45.0, 'largest disagreement with the predicted orientation, degrees', low=0.1, high=180.0
    )
    min_overlap: float = option(
        0.2, 'share of the points that must find the map after alignment', low=0.0, high=1.0
    )
    min_seen: float = option(
        0.15, 'share of the points in directions that an earlier scan must have seen',
        low=0.0, high=1.0,
    )  # fmt: skip
    min_consistent: float = option(
        0.15, 'share of those that must stand on what the earlier scan saw', low=0.0, high=1.0
    )


@dataclass(frozen=True)
class OdometryConfig(Section):
    """Settings of HybridOdometry."""

    registrar: str = option('hybridreg', 'which branch leads', choices=('hybridreg', 'kiss-icp'))
    sensor: str = option(
        'auto', 'kind of sensor; auto decides by the field of view of the first scan',
        choices=('auto', 'depth', 'lidar'),
    )  # fmt: skip
    voxel_size_m: float = option(
        0.0, 'voxel edge of the map, metres; 0 = chosen from the first scan', low=0.0, high=10.0
    )
    input: InputConfig = option(InputConfig, 'which scans are taken')
    preprocess: PreprocessConfig = option(PreprocessConfig, 'from cloud to registered points')
    map: MapConfig = option(MapConfig, 'the local map')
    refine: RefineConfig = option(RefineConfig, 'ICP against the local map')
    fallback: FallbackConfig = option(FallbackConfig, 'registration by kiss-icp')
    gate: GateConfig = option(GateConfig, 'when a network pose is trusted')
    keyframe: KeyframeConfig = option(KeyframeConfig, 'when a scan becomes a keyframe')
    lost: LostConfig = option(LostConfig, 'giving up a pose and coming back')
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

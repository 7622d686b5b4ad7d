# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Parts of the front end one by one, each against a rule that can fail."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_world import ROOM, Ball, Box, cast, depth_rays, lidar_rays, pose, walk

from hybridreg_ros.core import se3
from hybridreg_ros.core.pages import has_pages
from hybridreg_ros.core.scan import NS_PER_S, Scan
from hybridreg_ros.odometry.config import (
    InputConfig,
    KeyframeConfig,
    OdometryConfig,
    PreprocessConfig,
)
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.intake import Intake
from hybridreg_ros.odometry.keyframes import Keyframes
from hybridreg_ros.odometry.map.local_map import LocalMap
from hybridreg_ros.odometry.map.thinning import first_per_voxel
from hybridreg_ros.odometry.motion.prediction import Motion
from hybridreg_ros.odometry.preprocess import (
    believable,
    deskew,
    instants,
    preprocess,
    recognise_sensor,
)
from hybridreg_ros.odometry.registration import covariance
from hybridreg_ros.odometry.registration.alignment import align, assess
from hybridreg_ros.odometry.result import LOST_VARIANCE, Reason
from hybridreg_ros.odometry.selection.pose_confidence import PoseEvidence, of_evidence, worst_axis
from hybridreg_ros.odometry.visibility.range_image import (
    BEHIND,
    FRONT,
    ON,
    UNSEEN,
    RangeImage,
    view_of,
)

if TYPE_CHECKING:
    from hybridreg_ros.odometry.registration.alignment import Basin

CLOUD = cast(ROOM, pose(-1.0, -0.5, 0.0), lidar_rays(360, 40))[0]


def test_motion_predicts_along_the_screw_and_keeps_its_twist_while_coasting() -> None:
    step = se3.exp(np.array([0.1, 0.0, 0.02, 0.0, 0.0, 0.05]))
    motion = Motion(stamp=0)
    motion.advance(step, NS_PER_S // 10)
    np.testing.assert_allclose(motion.predict(3 * NS_PER_S // 10), step @ step @ step, atol=1e-12)
    motion.hold(step @ step, 2 * NS_PER_S // 10)
    np.testing.assert_allclose(motion.predict(3 * NS_PER_S // 10), step @ step @ step, atol=1e-12)
    motion.stop(NS_PER_S)
    assert np.array_equal(motion.predict(2 * NS_PER_S), step @ step)


@pytest.mark.parametrize('instant', [0.0, 0.03, -0.02])
def test_deskew_moves_each_point_along_the_screw(instant: float) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-20, 20, (200, 3)).astype(np.float32)
    times = rng.uniform(-0.02, 0.08, 200)
    twist = np.array([8.0, 0.5, -0.3, 0.1, -0.2, 1.5])
    expected = [
        se3.apply(se3.exp(twist * (t - instant)), p[None].astype(np.float64))[0]
        for p, t in zip(points, times, strict=True)
    ]
    np.testing.assert_allclose(deskew(points, times, twist, instant), expected, atol=1e-5)


@pytest.mark.parametrize(
    ('deskew_to', 'reported'), [('stamp', 0.0), ('start', -0.02), ('end', 0.08)]
)
def test_scans_are_registered_at_their_middle_and_reported_where_asked(
    deskew_to: str, reported: float
) -> None:
    scan = Scan(np.zeros((3, 3), np.float32), times=np.array([-0.02, 0.0, 0.08]))
    found = instants(scan, PreprocessConfig(deskew_to=deskew_to))
    np.testing.assert_allclose(found, [0.02, reported])
    assert instants(scan, PreprocessConfig(deskew=False)) == (0.0, 0.0)


@pytest.mark.parametrize('deskew_to', ['stamp', 'end'])
def test_pose_of_a_fast_rolling_scan_is_that_of_the_instant_asked_for(deskew_to: str) -> None:
    rays = lidar_rays(180, 24)
    times = np.tile(np.arange(180) / 1800.0, 24)
    twist = np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.6])
    start = pose(-3.0, -0.5, 0.0)
    odometry = HybridOdometry(
        OdometryConfig(preprocess=PreprocessConfig(deskew_to=deskew_to)), model=None
    )
    results = []
    for k in range(14):
        points = np.zeros((len(rays), 3), np.float32)
        for column in range(0, 180, 6):
            some = (np.arange(len(rays)) % 180) // 6 == column // 6
            T = start @ se3.exp(twist * (0.1 * k + times[some].mean()))
            points[some] = cast(ROOM, T, rays[some], seed=k)[0]
        results.append(odometry.step(Scan(points, times=times, stamp=5.0 + 0.1 * k)))
    np.testing.assert_allclose(results[-1].twist[0], 1.5, atol=0.1)
    np.testing.assert_allclose(results[-1].twist[5], 0.6, atol=0.06)
    moved = se3.inverse(results[4].pose) @ results[-1].pose
    off = se3.inverse(se3.exp(twist * 0.9)) @ moved
    assert np.linalg.norm(off[:3, 3]) < 0.03
    assert all(r.deskewed for r in results)


def test_deskew_sharpens_a_scan_taken_while_turning() -> None:
    rays = lidar_rays(360, 24)
    times = np.tile(np.arange(360) / 3600.0, 24)
    twist = np.array([0.6, 0.0, 0.0, 0.0, 0.0, 1.5])
    here = pose(-1.0, -0.5, 0.0)
    rows = np.arange(len(rays)) % 360
    points = np.zeros((len(rays), 3), np.float32)
    for column in range(0, 360, 4):
        some = (rows >= column) & (rows < column + 4)
        T = here @ se3.exp(twist * times[some].mean())
        points[some] = cast(ROOM, T, rays[some], noise_m=0.0)[0]
    still = cast(ROOM, here, rays, noise_m=0.0)[0]
    moved = deskew(points, times, twist, 0.0)

    def off_m(cloud: np.ndarray) -> float:
        from scipy.spatial import cKDTree

        return float(np.mean(cKDTree(still).query(cloud)[0]))

    assert off_m(moved) < 0.5 * off_m(points)


@pytest.mark.parametrize(
    ('times', 'good'),
    [
        ([0.0, 0.05, 0.1], True),
        ([0.1, 0.1, 0.1], False),
        ([0.0, np.nan, 0.1], False),
        ([0.0, np.inf, 0.1], False),
        ([0.0, 0.5, 1.5], False),
        ([1e6, 1e6 + 0.1, 1e6], False),
        ([], False),
    ],
)
def test_only_times_of_one_scan_are_believed(times: list[float], good: bool) -> None:
    assert believable(np.array(times)) is good


def test_sensor_is_recognised_and_config_overrules() -> None:
    assert recognise_sensor(CLOUD, OdometryConfig()).kind == 'lidar'
    ahead = cast(ROOM, pose(-1.0, -0.5, 0.0), depth_rays())[0]
    sensor = recognise_sensor(ahead, OdometryConfig())
    assert sensor.kind == 'depth'
    assert 0.02 <= sensor.voxel_size_m <= 0.2
    given = OdometryConfig(
        sensor='lidar', voxel_size_m=0.5, preprocess=PreprocessConfig(max_range_m=30.0)
    )
    assert recognise_sensor(ahead, given).voxel_size_m == 0.5
    assert recognise_sensor(ahead, given).max_range_m == 30.0


def test_voxel_hardly_grows_when_the_cloud_was_thinned_by_cubes() -> None:
    hall = (Box((-60.0, -25.0, 0.0), (60.0, 25.0, 8.0), inside=True),)
    raw = cast(hall, pose(1.0, -1.0, 0.0), lidar_rays(1080, 64))[0]
    thinned = raw[first_per_voxel(raw, 0.3)]
    of_points = [float(np.median(np.linalg.norm(points, axis=1))) for points in (raw, thinned)]
    sizes = [recognise_sensor(points, OdometryConfig()).voxel_size_m for points in (raw, thinned)]
    assert of_points[1] > 1.7 * of_points[0]  # so much larger it would be by the points
    assert sizes[0] < sizes[1] < 1.4 * sizes[0]


def test_preprocess_limits_ranges_and_thins_in_nested_steps() -> None:
    config = OdometryConfig(preprocess=PreprocessConfig(min_range_m=2.0, max_range_m=4.0))
    sensor = recognise_sensor(CLOUD, config)
    cloud = preprocess(Scan(CLOUD), sensor, config.preprocess, np.zeros(6))
    ranges = np.linalg.norm(cloud.map_points, axis=1)
    assert ranges.min() >= 2.0
    assert ranges.max() <= 4.0
    assert set(cloud.icp_rows) <= set(cloud.map_rows)
    assert np.array_equal(cloud.map_rows[cloud.icp_in_map], cloud.icp_rows)


def filled_map(voxel_m: float = 0.15) -> LocalMap:
    local_map = LocalMap(voxel_m, 50.0)
    local_map.update(CLOUD.astype(np.float64), np.zeros(3))
    return local_map


@pytest.mark.parametrize(
    ('basin', 'offset'),
    [
        ('fine', [0.02, 0.03, 0.01, 0.0, 0.0, 0.01]),
        ('middle', [0.1, -0.1, 0.03, 0.0, 0.0, 0.05]),
        ('coarse', [0.3, -0.2, 0.05, 0.02, 0.0, 0.3]),
    ],
)
def test_refinement_comes_back_from_an_offset(basin: Basin, offset: list[float]) -> None:
    guess = se3.exp(np.array(offset))
    points = cast(ROOM, pose(-1.0, -0.5, 0.0), lidar_rays(360, 40), seed=5)[0][::3]
    fit = align(points, guess, filled_map(), basin=basin)
    assert np.linalg.norm(fit.T_odom_sensor[:3, 3]) < 0.003
    assert se3.rotation_angle_deg(fit.T_odom_sensor[:3, :3]) < 0.05
    assert fit.overlap > 0.9


def test_refinement_ignores_points_of_no_weight() -> None:
    intruder = np.random.default_rng(1).normal([2.0, 0.0, 0.0], 0.1, (3000, 3))
    local_map = filled_map()
    local_map.update(intruder + 0.1, np.zeros(3))
    points = np.concatenate([CLOUD[::5], intruder]).astype(np.float32)
    weights = np.r_[np.ones(len(CLOUD[::5])), np.zeros(len(intruder))]
    fit = align(points, np.eye(4), local_map, weights, 'fine')
    assert np.linalg.norm(fit.T_odom_sensor[:3, 3]) < 0.002


def test_corridor_leaves_its_axis_uncertain() -> None:
    rng = np.random.default_rng(2)
    side = rng.uniform([-8, -1, -1], [8, 1, 1], (20_000, 3))
    walls = side.copy()
    walls[::2, 1] = np.sign(side[::2, 1])
    walls[1::2, 2] = np.sign(side[1::2, 2])
    walls += rng.normal(0.0, 0.003, walls.shape)
    local_map = LocalMap(0.15, 50.0)
    local_map.update(walls, np.zeros(3))
    fit = assess(walls[5::11].astype(np.float32), np.eye(4), local_map)
    spread = np.sqrt(np.diag(covariance.of_pose(fit.information, 1.0)))
    assert spread[0] > 10.0 * max(spread[1], spread[2])


def test_map_forgets_what_is_out_of_reach_and_erases_what_moved() -> None:
    local_map = LocalMap(0.2, 10.0)
    for k in range(30):
        place = np.array([2.0 * k, 0.0, 0.0])
        local_map.update(CLOUD.astype(np.float64) + place, place)
    kept = local_map.fine.points()
    assert np.abs(kept[:, 0] - 58.0).max() < 13.0
    some = kept[:50].copy()
    assert local_map.erase(some) >= 50
    left = {tuple(p) for p in local_map.fine.points()}
    assert not any(tuple(p) in left for p in some)


def test_map_size_is_bounded_while_standing() -> None:
    local_map = filled_map()
    local_map.update(CLOUD.astype(np.float64), np.zeros(3))
    before = len(local_map.fine.points())
    for _ in range(5):
        local_map.update(CLOUD.astype(np.float64), np.zeros(3))
    assert len(local_map.fine.points()) == before


def test_points_stand_in_front_on_and_behind() -> None:
    image = RangeImage(CLOUD, view_of(CLOUD, 'lidar'), np.eye(4))
    wall = CLOUD[::7]
    stand = image.stand(wall, np.eye(4), 0.05, 0.01)
    assert np.mean(stand == ON) > 0.99
    assert np.mean(image.stand(0.6 * wall, np.eye(4), 0.05, 0.01) == FRONT) > 0.6
    assert np.mean(image.stand(1.5 * wall, np.eye(4), 0.05, 0.01) == BEHIND) > 0.9
    above = np.array([[0.0, 0.0, 5.0]], np.float32)
    assert image.stand(above, np.eye(4), 0.05, 0.01)[0] == UNSEEN


def test_stand_uses_both_poses() -> None:
    image = RangeImage(CLOUD, view_of(CLOUD, 'lidar'), pose(-1.0, -0.5, 0.0))
    there = pose(-0.6, -0.3, 30.0)
    other = cast(ROOM, there, lidar_rays(180, 24), seed=9)[0]
    right = image.stand(other, there, 0.05, 0.01)
    wrong = image.stand(other, pose(-0.6, -0.3, 50.0), 0.05, 0.01)
    assert np.mean(right == ON) > 0.85
    assert np.mean(wrong == ON) < 0.6


def test_an_image_in_pages_of_its_own_is_the_same() -> None:
    image = RangeImage(CLOUD, view_of(CLOUD, 'lidar'), pose(-1.0, -0.5, 0.0))
    kept, there = image.paged(), pose(-0.6, -0.3, 30.0)
    for strict in (False, True):
        stand = image.stand(CLOUD, there, 0.05, 0.01, strict)
        assert len(np.unique(stand)) == 4
        np.testing.assert_array_equal(kept.stand(CLOUD, there, 0.05, 0.01, strict), stand)
    arrays = {name: v for name, v in vars(image).items() if getattr(v, 'ndim', 0) == 2}
    assert len(arrays) == 4
    for name in arrays.keys() - {'T_odom_sensor'}:
        assert has_pages(vars(kept)[name])
        assert not has_pages(arrays[name])


def test_thing_that_came_stands_in_front() -> None:
    image = RangeImage(CLOUD, view_of(CLOUD, 'lidar'), np.eye(4))
    world = (*ROOM, Ball((1.0, -0.5, 1.2), 0.3, (1.0, 0.0, 0.0)))
    points, moving = cast(world, pose(-1.0, -0.5, 0.0), lidar_rays(360, 40), seed=4)
    stand = image.stand(points, np.eye(4), 0.05, 0.01, strict=True)
    assert np.mean(stand[moving] == FRONT) > 0.95
    assert np.mean(stand[~moving] == FRONT) < 0.001


def test_confidence_orders_evidence() -> None:
    good, poor = PoseEvidence(0.95, 0.9, 0.97, 0.0, -2.7), PoseEvidence(0.55, 0.9, 0.6, 0.0, -2.0)
    assert of_evidence(good) > 0.95 > 0.75 > of_evidence(poor) > 0.02
    assert (
        of_evidence(PoseEvidence(0.95, 0.9, 0.97, 0.0, -1.0)) < 0.5
    )  # one direction is held loosely
    assert (
        worst_axis(1e-5) == worst_axis(0.003) < worst_axis(0.03) == pytest.approx(-1.523, abs=1e-3)
    )


def test_intake_rebases_only_on_a_steady_new_time_base() -> None:
    intake = Intake(InputConfig(rebase_after=2))
    points = np.zeros((1, 3), np.float32)

    def taken(stamp_s: float) -> bool:
        scan = Scan(points, stamp=stamp_s, frame_id='a')
        return intake.check(scan) is None or intake.rebased(scan)

    assert [taken(t) for t in (10.0, 10.1, 5000.0, 10.2, 5000.0, 7000.0, 7000.1, 7000.2)] == [
        True,
        True,
        False,
        True,
        False,
        False,
        True,
        True,
    ]
    assert intake.refused[Reason.STAMP_JUMP] == 4


def test_keyframe_rule_and_choice() -> None:
    keyframes = Keyframes(KeyframeConfig(max_distance=10.0, max_age_s=2.0, memory=4), 0.1)
    cloud = np.zeros((5, 3), np.float32)
    assert keyframes.to_match(np.eye(4)) is None
    for k in range(6):
        keyframes.add(pose(float(k), 0.0, 0.0), k * NS_PER_S, cloud)
    assert [f.number for f in keyframes] == [2, 3, 4, 5]
    here = pose(5.5, 0.0, 0.0)
    assert not keyframes.wanted(here, 5 * NS_PER_S, overlap=0.9)
    assert keyframes.wanted(here, 5 * NS_PER_S, overlap=0.5)
    assert keyframes.wanted(here, 8 * NS_PER_S, overlap=0.9)
    assert keyframes.wanted(pose(6.5, 0.0, 0.0), 5 * NS_PER_S, overlap=0.9)
    assert keyframes.wanted(pose(5.5, 0.0, 40.0), 5 * NS_PER_S, overlap=0.9)
    assert [f.number for f in keyframes.recent] == [3, 4, 5]
    assert all(has_pages(f.points) for f in keyframes)
    nearest = keyframes.to_match(pose(3.2, 0.0, 0.0))
    assert nearest is not None
    assert nearest.number == 3
    assert [f.number for f in keyframes.nearest(pose(2.2, 0.0, 0.0), 2)] == [2, 3]


def test_a_place_seen_again_keeps_one_keyframe() -> None:
    keyframes = Keyframes(KeyframeConfig(max_distance=10.0, window=2, memory=9), 0.1)
    places = [0.0, 1.0, 2.0, 3.0, 2.1, 1.1, 0.1]
    for k, x in enumerate(places):
        keyframes.add(pose(x, 0.0, 0.0), k, np.zeros((1, 3), np.float32))
    assert [f.number for f in keyframes] == [3, 4, 5, 6]
    lost = keyframes.nearest(np.eye(4), 3)
    assert [round(float(f.T_odom_keyframe[0, 3]), 1) for f in lost] == [0.1, 1.1, 2.1]


def test_covariances_have_their_limits() -> None:
    nothing = covariance.of_pose(np.zeros((6, 6)), 1.0)
    assert np.isfinite(nothing).all()
    assert np.diag(nothing).max() < 101.0
    assert np.diag(covariance.lost()).tolist() == [LOST_VARIANCE] * 6
    unknown = covariance.of_twist(nothing, np.eye(4), 0.0)
    assert np.array_equal(unknown, covariance.lost())
    information = np.diag([1e4, 1e2, 1e4, 1e5, 1e5, 1e5])
    turned = covariance.of_twist(covariance.of_pose(information, 1.0), pose(0.0, 0.0, 90.0), 0.5)
    np.testing.assert_allclose(turned[0, 0], 2.0 * 1e-2 / 0.25)
    np.testing.assert_allclose(turned[1, 1], 2.0 * 1e-4 / 0.25)


def test_memory_stays_bounded_over_many_frames() -> None:
    poses = walk(4, step_m=0.05)
    loop = [*poses, *poses[::-1]]
    odometry = HybridOdometry(model=None)
    sizes = []
    for k in range(48):
        points = cast(ROOM, loop[k % len(loop)], lidar_rays(120, 16), seed=k % 8)[0]
        odometry.step(Scan(points, stamp=10.0 + 0.1 * k, frame_id='s'))
        tracker = odometry._tracker
        assert tracker is not None
        sizes.append(len(tracker._world.map.fine.points()))
    assert sizes[-1] <= 1.02 * sizes[15]

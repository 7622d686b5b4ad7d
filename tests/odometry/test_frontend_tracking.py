# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridOdometry without a network: it follows the sensor, and says how sure it is."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from neighbourhood_registrar import NeighbourhoodRegistrar
from tiny_world import depth_rays, lidar_rays, pose, scans, walk

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.registration.kiss import KissRegistration
from hybridreg_ros.odometry.result import OdometryResult, Reason, Rest, Source

if TYPE_CHECKING:
    from collections.abc import Callable


def run(clouds: list, **settings: Any) -> list[OdometryResult]:
    odometry = HybridOdometry(OdometryConfig(**settings), model=None)
    return [odometry.step(scan) for scan in clouds]


def errors(results: list[OdometryResult], poses: list) -> tuple[float, float]:
    """Largest position (m) and rotation (deg) error against the truth."""
    start = se3.inverse(poses[0])
    off = [se3.inverse(start @ T) @ r.pose for T, r in zip(poses, results, strict=True)]
    return (
        max(float(np.linalg.norm(T[:3, 3])) for T in off),
        max(se3.rotation_angle_deg(T[:3, :3]) for T in off),
    )


@pytest.mark.parametrize('rays', [lidar_rays(), depth_rays()], ids=['lidar', 'depth'])
def test_follows_a_walk(rays: np.ndarray) -> None:
    poses = walk(12)
    results = run(scans(poses, rays))
    shift_m, turn_deg = errors(results, poses)
    assert shift_m < 0.02
    assert turn_deg < 0.3
    assert results[0].reason is Reason.FIRST_SCAN
    assert np.array_equal(results[0].pose, np.eye(4))
    for result in results[1:]:
        assert result.source is Source.KISS_ICP
        assert result.reason is Reason.NO_WEIGHTS
        assert result.confidence > 0.9
        assert result.dynamic_probability.shape == (len(result.scan),)
        assert {'preprocess', 'refine', 'map', 'total'} <= set(result.timings_s)


def test_twist_is_the_motion_in_the_sensor_frame() -> None:
    results = run(scans(walk(8, step_m=0.08, turn_deg=2.0), lidar_rays()))
    expected = [0.8, 0.0, 0.0, 0.0, 0.0, np.deg2rad(20.0)]
    np.testing.assert_allclose(results[-1].twist, expected, atol=0.08)
    assert (np.diag(results[-1].twist_covariance) > 0.0).all()


def test_covariance_is_small_symmetric_and_positive() -> None:
    covariance = run(scans(walk(4), lidar_rays()))[-1].covariance
    np.testing.assert_allclose(covariance, covariance.T)
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    assert np.sqrt(np.diag(covariance)).max() < 0.1


def test_registrar_kiss_icp_is_named_as_the_reason() -> None:
    results = run(scans(walk(3), lidar_rays()), registrar='kiss-icp')
    assert [r.reason for r in results[1:]] == [Reason.REGISTRAR_KISS_ICP] * 2


def test_kiss_icp_makes_every_pose_that_bears_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    align = KissRegistration.align

    def counting(self: KissRegistration, points: np.ndarray, *how: Any) -> np.ndarray:
        asked.append(len(points))
        return align(self, points, *how)

    monkeypatch.setattr(KissRegistration, 'align', counting)
    odometry = HybridOdometry(OdometryConfig(registrar='kiss-icp'), model=None)
    clouds = scans(walk(5), lidar_rays())
    odometry.step(clouds[0])
    for scan in clouds[1:4]:
        asked.clear()
        assert odometry.step(scan).source is Source.KISS_ICP
        assert asked
        assert min(asked) > 100

    def refusing(self: KissRegistration, points: np.ndarray, *how: Any) -> np.ndarray:
        raise RegistrationError('no')

    monkeypatch.setattr(KissRegistration, 'align', refusing)
    result = odometry.step(clouds[4])
    assert result.reason is Reason.REFINEMENT_FAILED
    assert result.confidence == 0.0


@pytest.mark.parametrize('turns_deg', [(0.0, 18.0, -14.0, 20.0, 0.0, -20.0, 15.0)])
def test_uneven_turns_between_scans_do_not_lose_it(turns_deg: tuple[float, ...]) -> None:
    poses = [pose(-1.0 + 0.1 * k, -0.5, sum(turns_deg[: k + 1])) for k in range(len(turns_deg))]
    results = run(scans(poses, lidar_rays(), period_s=0.5), registrar='kiss-icp')
    assert {r.source for r in results} == {Source.KISS_ICP}
    shift_m, turn_deg = errors(results, poses)
    assert shift_m < 0.03
    assert turn_deg < 0.5


def test_reset_starts_a_new_odom_frame() -> None:
    clouds = scans(walk(4), lidar_rays())
    odometry = HybridOdometry(model=None)
    for scan in clouds[:3]:
        odometry.step(scan)
    odometry.reset()
    result = odometry.step(clouds[3])
    assert result.reason is Reason.FIRST_SCAN
    assert np.array_equal(result.pose, np.eye(4))


def test_the_pose_is_given_before_the_map_knows_the_scan() -> None:
    clouds = scans(walk(5), lidar_rays())
    odometry, early, results = HybridOdometry(OdometryConfig(), model=None), [], []
    for scan in clouds:
        first, rest = odometry.locate(scan)
        assert odometry._tracker is not None
        early.append((first, odometry._tracker._world.map.updates))
        results.append(rest())
        assert rest() is results[-1]  # it is done once
    plain = run(clouds)
    assert [n for _, n in early] == [1, 1, 2, 3, 4]  # the first scan is the map itself
    for (first, _), result, alone in zip(early, results, plain, strict=True):
        for name in ('pose', 'covariance', 'twist', 'twist_covariance'):
            assert np.array_equal(getattr(first, name), getattr(result, name))
            assert np.array_equal(getattr(result, name), getattr(alone, name))
        assert (first.confidence, first.reason) == (result.confidence, result.reason)
        assert not first.dynamic_probability.any()
        assert np.array_equal(result.dynamic_probability, alone.dynamic_probability)


@pytest.mark.parametrize('by', ['another thread', 'nobody'])
def test_the_rest_of_a_step_may_be_made_elsewhere(by: str) -> None:
    clouds = scans(walk(6), lidar_rays())
    odometry = HybridOdometry(OdometryConfig(), model=NeighbourhoodRegistrar())
    alone = HybridOdometry(OdometryConfig(), model=NeighbourhoodRegistrar())
    rests: list[Callable[[], OdometryResult]] = []
    with ThreadPoolExecutor(1) as other:
        for scan in clouds:
            rest = odometry.locate(scan)[1]
            rests.append(other.submit(rest).result if by == 'another thread' else rest)
    for scan, whole in zip(clouds, rests, strict=True):
        expected, found = alone.step(scan), whole()
        assert np.array_equal(found.pose, expected.pose)
        assert np.array_equal(found.dynamic_probability, expected.dynamic_probability)
        assert found.is_keyframe == expected.is_keyframe


def test_a_rest_that_fails_raises_where_it_was_made_and_holds_nobody_up() -> None:
    rest = Rest(partial(divmod, 1, 0))
    with pytest.raises(ZeroDivisionError):
        rest()
    rest.wait()
    with pytest.raises(RuntimeError, match='the rest of this step failed'):
        rest()


def test_the_rest_of_a_refused_scan_is_its_refusal() -> None:
    clouds = scans(walk(2), lidar_rays())
    odometry = HybridOdometry(OdometryConfig(), model=None)
    for scan in clouds:
        odometry.step(scan)
    result, rest = odometry.locate(clouds[1])
    assert not result.accepted
    assert rest() is result

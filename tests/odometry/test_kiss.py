# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""kiss-icp behind its guards: what aborts its process must not reach it."""

from __future__ import annotations

import numpy as np
import pytest
from tiny_world import ROOM, cast, lidar_rays, walk

from hybridreg_ros.benchmark.pipelines import KissIcp
from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.odometry.registration.kiss import KissRegistration

POSES = walk(3)
CLOUDS = [cast(ROOM, T, lidar_rays(), seed=k)[0] for k, T in enumerate(POSES)]


def test_registration_finds_a_small_motion() -> None:
    kiss = KissRegistration(0.15, 20.0)
    kiss.rebuild(CLOUDS[0])
    found = kiss.align(CLOUDS[1][::5], np.eye(4), 0.3)
    truth = se3.inverse(POSES[0]) @ POSES[1]
    assert se3.rotation_angle_deg((se3.inverse(truth) @ found)[:3, :3]) < 0.5


def test_few_points_empty_map_and_wild_guess_are_errors() -> None:
    kiss = KissRegistration(0.15, 20.0)
    with pytest.raises(RegistrationError, match='needs a map and 10 points, found 3'):
        kiss.align(CLOUDS[0][:3], np.eye(4), 0.3)
    with pytest.raises(RegistrationError, match='needs a map'):
        kiss.align(CLOUDS[0], np.eye(4), 0.3)
    kiss.rebuild(CLOUDS[0])
    with pytest.raises(RegistrationError, match='first guess is not a rigid transform'):
        kiss.align(CLOUDS[0], np.full((4, 4), np.nan), 0.3)


def test_nan_and_absurd_points_are_left_out() -> None:
    kiss = KissRegistration(0.15, 20.0)
    wild = np.array([[np.nan, 0, 0], [1e9, 0, 0], [0, -np.inf, 0]])
    kiss.rebuild(np.concatenate([wild, CLOUDS[0]]))
    found = kiss.align(np.concatenate([CLOUDS[0][::5], wild]), np.eye(4), 0.3)
    np.testing.assert_allclose(found, np.eye(4), atol=0.01)


def test_rebuild_replaces_the_map() -> None:
    kiss = KissRegistration(0.15, 20.0)
    kiss.rebuild(CLOUDS[0])
    kiss.rebuild(np.zeros((0, 3)))
    with pytest.raises(RegistrationError, match='needs a map'):
        kiss.align(CLOUDS[0], np.eye(4), 0.3)


@pytest.mark.parametrize('times', [None, 'equal', 'nan', 'short', 'empty', 'good'], ids=str)
def test_plain_kiss_icp_survives_any_times(times: str | None) -> None:
    plain = KissIcp(0.15, 20.0)
    for cloud in CLOUDS:
        n = len(cloud)
        given = {
            None: None,
            'equal': np.full(n, 0.05),
            'nan': np.where(np.arange(n) == 7, np.nan, np.arange(n) / n),
            'short': np.arange(n - 1) / n,
            'empty': np.zeros(0),
            'good': np.arange(n) / n * 0.1,
        }[times]
        found = plain.step(cloud, given)
        assert se3.is_rigid(found)


def test_plain_kiss_icp_keeps_its_pose_on_empty_clouds() -> None:
    plain = KissIcp(0.15, 20.0)
    assert np.array_equal(plain.step(np.zeros((0, 3))), np.eye(4))
    for cloud in CLOUDS:
        last = plain.step(cloud)
    assert np.array_equal(plain.step(np.full((50, 3), np.nan)), last)

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Augmentation: the same pair as another sensor would have seen it from other places."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hybridreg_ros.core import se3

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.pair import PointPair
    from hybridreg_ros.training.config import AugmentConfig

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    Rng = np.random.Generator

FEWEST_POINTS = 200


class _Cloud(NamedTuple):
    points: F32
    label: NDArray[np.uint8]
    instance: NDArray[np.uint16]


def augment(pair: PointPair, config: AugmentConfig, rng: Rng) -> PointPair:
    """A randomly changed copy of a pair; its transform stays true.

    Args:
        pair: as made by a generator or loader.
        config: how much of what.
        rng: all randomness comes from here.
    """
    source = _Cloud(pair.source, pair.source_label, pair.source_instance)
    target = _Cloud(pair.target, pair.target_label, pair.target_instance)
    source, target = (_thinned(_damaged(c, config, rng), config, rng) for c in (source, target))
    source, target = (_noisy(c, pair.voxel_size_m, config, rng) for c in (source, target))
    scale = 1.0 + rng.uniform(-config.scale_jitter, config.scale_jitter)
    R = common_rotation(config, rng, vertical_axis(pair))
    A = relative_motion(source.points, config, rng)
    C = se3.transform(R, np.zeros(3))
    T = C @ pair.T_target_source @ se3.inverse(A) @ se3.inverse(C)
    T[:3, 3] *= scale
    factor = np.float32(scale)
    return dataclasses.replace(
        pair,
        source=factor * se3.apply(C @ A, source.points),
        target=factor * se3.apply(C, target.points),
        T_target_source=T,
        source_label=source.label,
        target_label=target.label,
        source_instance=source.instance,
        target_instance=target.instance,
    )


def random_rotation(rng: Rng) -> F64:
    """Rotation (3, 3) drawn uniformly from SO(3)."""
    w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def vertical_axis(pair: PointPair) -> int:
    """Axis that is the vertical of a levelled sensor: 1 in the optical frame of a camera, else 2.

    In an optical frame (z forward, y down) no point lies behind the sensor.
    """
    behind = any(bool((cloud[:, 2] <= 0.0).any()) for cloud in (pair.source, pair.target))
    return 2 if behind else 1


def common_rotation(config: AugmentConfig, rng: Rng, vertical: int = 2) -> F64:
    """Rotation (3, 3) that both clouds get: any, or about the vertical and tilted, or small.

    Args:
        config: how much of what.
        rng: all randomness comes from here.
        vertical: number of the axis that yaw turns about.
    """
    if rng.random() < config.any_rotation_share:
        return random_rotation(rng)
    yaw = config.yaw_share > 0.0 and rng.random() < config.yaw_share
    tilt = config.tilt_share > 0.0 and rng.random() < config.tilt_share
    if not yaw and not tilt:
        return se3.so3_exp(rng.normal(0.0, 1.0, 3) * config.common_rotation_rad)
    R: F64 = np.eye(3)
    if yaw:
        R = se3.so3_exp(rng.uniform(-np.pi, np.pi) * np.eye(3)[vertical])
    if tilt:
        along, angle = rng.uniform(-np.pi, np.pi), np.deg2rad(rng.uniform(0.0, config.tilt_deg))
        level = np.insert([np.cos(along), np.sin(along)], vertical, 0.0)
        R = se3.so3_exp(angle * level) @ R
    return R


def relative_motion(points: F32, config: AugmentConfig, rng: Rng) -> F64:
    """Extra motion (4, 4) of the source about its centroid."""
    if rng.random() < config.large_share:
        axis = rng.normal(size=3)
        angle = np.deg2rad(rng.uniform(0.0, config.large_rotation_deg))
        w = angle * axis / max(float(np.linalg.norm(axis)), 1e-9)
    else:
        w = rng.normal(0.0, 1.0, 3) * config.relative_rotation_rad
    R = se3.so3_exp(w)
    centre = points.mean(axis=0, dtype=np.float64) if len(points) else np.zeros(3)
    return se3.transform(R, centre - R @ centre)


def _kept(cloud: _Cloud, keep: NDArray[np.bool_]) -> _Cloud:
    """The marked points, unless too few would be left."""
    if int(keep.sum()) < FEWEST_POINTS:
        return cloud
    return _Cloud(cloud.points[keep], cloud.label[keep], cloud.instance[keep])


def _damaged(cloud: _Cloud, config: AugmentConfig, rng: Rng) -> _Cloud:
    """Cut off behind a random plane, and behind one occluder near the sensor."""
    if rng.random() < config.crop_share:
        along = cloud.points @ rng.normal(size=3).astype(np.float32)
        keep = rng.uniform(config.crop_keep, 1.0)
        cloud = _kept(cloud, along <= np.quantile(along, keep))
    if rng.random() < config.hole_share:
        rays = cloud.points / np.maximum(np.linalg.norm(cloud.points, axis=1), 1e-6)[:, None]
        axis = rays[rng.integers(len(rays))]
        half = np.deg2rad(rng.uniform(0.0, config.hole_angle_deg))
        cloud = _kept(cloud, rays @ axis < np.cos(half))
    return cloud


def _thinned(cloud: _Cloud, config: AugmentConfig, rng: Rng) -> _Cloud:
    """Random points taken away."""
    if rng.random() >= config.thin_share:
        return cloud
    return _kept(cloud, rng.random(len(cloud.points)) < rng.uniform(config.thin_keep, 1.0))


def _noisy(cloud: _Cloud, voxel_m: float, config: AugmentConfig, rng: Rng) -> _Cloud:
    """Noise of every coordinate, and noise along the ray that grows with the range."""
    spread = np.float32(rng.uniform(0.0, config.noise_voxels) * voxel_m)
    along = np.float32(rng.uniform(0.0, config.depth_noise))
    n = len(cloud.points)
    points = cloud.points * (1.0 + along * rng.standard_normal((n, 1), np.float32))
    points = points + spread * rng.standard_normal((n, 3), np.float32)
    return cloud._replace(points=points)

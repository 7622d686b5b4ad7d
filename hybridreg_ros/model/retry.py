# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Further attempts at a pair that left doubt: the other way round, and in rotated frames.

The network does not see the same thing in a rotated pair: voxels cut surfaces elsewhere and kernel
points lie elsewhere on them; and what is aligned with what differs when source and target change
places. What one attempt misses another may find, and a wrong pose seldom comes twice (test-time
augmentation, for doubtful pairs only).
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.model.geometry.upright import along_walls, upright

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from hybridreg_ros.model.result import RegistrationResult

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]


def _rotation(*degrees: float) -> F64:
    """Rotation (3, 3) by a rotation vector, degrees."""
    return se3.so3_exp(np.deg2rad(np.array(degrees)))


FRAMES = (
    _rotation(0.0, 0.0, 180.0),
    _rotation(0.0, 0.0, 90.0),
    _rotation(20.0, 0.0, 0.0),
)
"""Rotations to the frames of further attempts, in this order, from the frame along the walls; the
network has seen streets along x only, so one of the first two suits it better than the other."""

NARROW_FRAMES = (
    _rotation(0.0, 0.0, 0.0),
    _rotation(0.0, 20.0, 0.0),
    _rotation(20.0, 0.0, 0.0),
)
"""The same for sensors with a narrow view, from their upright frame."""


def frames_of(source: F32, target: F32, *normals: F32) -> tuple[F64, ...]:
    """Rotations (3, 3) from the sensor frame to those of the further attempts.

    Those of a narrow view turn with the clouds, so a pair has the same further attempts however
    the camera is mounted; views all round are taken to be upright (z up, REP 103), and turn with
    the walls about the vertical.

    Args:
        source: (N, 3) sensor frame, metres.
        target: (M, 3) likewise.
        normals: (K, 3) unit normals of each cloud.
    """
    C = upright(source, target)
    if C is None:
        return tuple(R @ along_walls(*normals) for R in FRAMES)
    return tuple(R @ C for R in NARROW_FRAMES)


def in_order(source: F32, target: F32) -> bool:
    """Whether further attempts keep source and target as they are: the nearer cloud goes first.

    So they do not depend on which cloud is called source, nor on how the sensor is mounted.

    Args:
        source: (N, 3) sensor frame, metres; rows with NaN or inf are ignored.
        target: (M, 3) likewise.
    """
    finite = (cloud[np.isfinite(cloud).all(axis=1)] for cloud in (source, target))
    near, far = (float(np.linalg.norm(points, axis=1).mean()) for points in finite)
    return near <= far


def exchanged(result: RegistrationResult) -> RegistrationResult:
    """The result, had source and target been each other: poses (4, 4) inverted, sides swapped."""
    matches = result.correspondences
    return dataclasses.replace(
        result,
        T_target_source=se3.inverse(result.T_target_source),
        T_lgr=se3.inverse(result.T_lgr),
        source_uncertainty=result.target_uncertainty,
        target_uncertainty=result.source_uncertainty,
        correspondences=dataclasses.replace(matches, source=matches.target, target=matches.source),
    )


def rotated(points: F32, R: F64) -> F32:
    """Points (N, 3) in a rotated frame; R: (3, 3)."""
    return points @ R.T.astype(np.float32)


def rotated_back(result: RegistrationResult, R: F64) -> RegistrationResult:
    """A result found in rotated frames, in those of the sensors; R: (3, 3) as in `rotated`."""
    C = se3.transform(R, np.zeros(3))
    matches = result.correspondences
    return dataclasses.replace(
        result,
        T_target_source=se3.inverse(C) @ result.T_target_source @ C,
        T_lgr=se3.inverse(C) @ result.T_lgr @ C,
        correspondences=dataclasses.replace(
            matches, source=rotated(matches.source, R.T), target=rotated(matches.target, R.T)
        ),
    )


def most_confident(
    first: RegistrationResult,
    attempts: Iterable[Callable[[], RegistrationResult]],
    sure: float,
) -> RegistrationResult:
    """The most confident of several attempts; none is made once there is no doubt.

    Args:
        first: result of the first attempt.
        attempts: further ones.
        sure: confidence from which there is no doubt.

    Returns:
        A result with the summed `timings_s` and the number of all `attempts`. A pair that left
        doubt at first sight stays below certainty: its confidence is at most `sure`.
    """
    best, count, timings = first, first.attempts, dict(first.timings_s)
    for attempt in attempts:
        if best.confidence >= sure:
            break
        count += 1
        try:
            result = attempt()
        except RegistrationError:  # too few voxels are left when they are cut this way
            continue
        more = result.timings_s
        timings = {stage: seconds + more.get(stage, 0.0) for stage, seconds in timings.items()}
        best = max(best, result, key=lambda r: r.confidence)
    if count == first.attempts:
        return first
    confidence = min(best.confidence, sure)
    return dataclasses.replace(best, confidence=confidence, attempts=count, timings_s=timings)

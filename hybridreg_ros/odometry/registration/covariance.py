# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pose and twist covariance from the information matrix of the registration."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hybridreg_ros.core import se3
from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.registration.kernels import scaled, units_of
from hybridreg_ros.odometry.result import LOST_VARIANCE

if TYPE_CHECKING:
    from hybridreg_ros.odometry.registration.alignment import Fit

F64 = NDArray[np.float64]

_LARGEST_STD = 10.0
"""Cap of standard deviations (metres, radians): below LOST_VARIANCE, far above any use."""
_SLOW = np.array([0.5, 0.2])
"""Speed (m/s) and rate (rad/s) at which a sensor that was at rest may be moved by hand."""
_FIRST_SPEED = np.array([5.0, 1.75])
"""The same of a sensor about which nothing is known: 0.5 m and 10 degrees a scan."""
_FREE = np.array([0.5, 0.175])
"""Standard deviation, metres and rad, of a pose along what nothing holds, next to one that was
held: as much as that of a first prediction, about which nothing is known either."""
_COASTING = 100.0
"""Growth of the covariance per frame whose pose is only predicted."""
_WEAK = 0.5
"""Share of a direction that must lie in the space that nothing holds."""
DRIFT = {'depth': np.repeat([0.004, 0.001], 3), 'lidar': np.repeat([0.001, 0.00025], 3)}
"""Standard deviation of what the motion of a kind of sensor is off by all the time, along and
about each of its axes: m and rad per metre from a keyframe. Bent depth images, rings on few
surfaces and loose normals pull every scan the same way. Likeliest for positions on development
sequences; of a lidar several times that, for what a simulated one does not have
(docs/lab/2026-11-30-drift-by-sensor.md)."""


def lost() -> F64:
    """Covariance (6, 6) of a pose that must not be used."""
    return np.eye(6) * LOST_VARIANCE


def first() -> F64:
    """Covariance (6, 6) of the first pose: it defines the odom frame, so it has no error."""
    return np.eye(6) * 1e-12


def of_pose(information: F64, factor: float) -> F64:
    """Inverse information, scaled; directions that the points do not hold get the cap.

    Args:
        information: (6, 6), 1/m^2 and 1/rad^2.
        factor: scale of the covariance.

    Returns:
        (6, 6) symmetric, positive definite.
    """
    capped: F64 = _inverse(np.ascontiguousarray(information), factor)
    return capped


@compiled
def _inverse(information, factor):  # type: ignore[no-untyped-def]
    """The kernel of `of_pose`."""
    unit = units_of(information, 1e-9)
    values, vectors = np.linalg.eigh(scaled(information, unit, 0.0))
    held = scaled((vectors / np.maximum(values, 1e-6)) @ vectors.T * factor, unit, 0.0)
    capped = scaled(held, np.maximum(1.0, units_of(held, 0.0) / _LARGEST_STD), 0.0)
    return 0.5 * (capped + capped.T)


def of_fit(fit: Fit, ahead_s: float, factor: float) -> F64:
    """Covariance (6, 6), odom axes, of the pose that is reported of a registered scan.

    Args:
        fit: the scan in the map.
        ahead_s: from the instant of the fit to the one reported, seconds.
        factor: scale of the covariance.
    """
    covariance = of_pose(fit.information, factor)
    if fit.intra_scan is None or ahead_s == 0.0:
        return covariance
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = fit.T_odom_sensor[:3, :3]
    carried: F64 = covariance + factor * turn @ fit.intra_scan.spread_at(ahead_s) @ turn.T
    return carried


def of_registration(fit: Fit, ahead_s: float, factor: float) -> F64:
    """Covariance (6, 6), odom axes, of a pose in its surroundings, told with the pose.

    Points err on their own, and alike within the parts of a scan; along what no surface holds the
    pose is as a first prediction is.

    Args:
        fit: the scan in the map.
        ahead_s: from the instant of the fit to the one reported, seconds.
        factor: scale of the covariance that follows from the points.
    """
    predicted = factor * fit.unheld @ np.diag(np.repeat(_FREE**-2, 3)) @ fit.unheld
    held = replace(fit, information=fit.information + predicted)
    covariance: F64 = of_fit(held, ahead_s, factor) + fit.cluster_covariance
    return covariance


@dataclass(frozen=True, eq=False)
class Surroundings:
    """How far off what a sensor sees from a pose is, odom axes.

    Attributes:
        random: (6, 6) covariance of the errors that differ from scan to scan.
        drift: (6, 6) a column for each bias of the motion: what one standard deviation of it has
            added up to since the start.
    """

    random: F64
    drift: F64 = field(default_factory=lambda: np.zeros((6, 6)))

    @property
    def covariance(self) -> F64:
        """Covariance (6, 6) of both."""
        both: F64 = self.random + self.drift @ self.drift.T
        return both

    def carried(self, start: F64, pose: F64, bias: F64) -> Surroundings:
        """What is fixed to a pose (4, 4) of these surroundings, at another pose (4, 4).

        Args:
            start: the pose that it is fixed to.
            pose: the other one.
            bias: (6,) of the sensor, one of `DRIFT`.
        """
        shift = pose[:3, 3] - start[:3, 3]
        lever, turn = np.eye(6), np.zeros((6, 6))
        lever[:3, 3:] = -se3.hat(shift)
        turn[:3, :3] = turn[3:, 3:] = pose[:3, :3]
        drift = lever @ self.drift + np.linalg.norm(shift) * turn * bias
        return Surroundings(lever @ self.random @ lever.T, drift)


def weakest_m(covariance: F64) -> float:
    """Standard deviation, metres, of the position along the direction held worst.

    Args:
        covariance: (6, 6) of a pose.
    """
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))


def coasting(covariance: F64, floor_m: float) -> F64:
    """Covariance (6, 6) of a pose that is only predicted from one of this covariance.

    Args:
        covariance: (6, 6) of the last pose.
        floor_m: at least this standard deviation is added (metres; radians too).
    """
    grown: F64 = np.minimum(_COASTING * covariance, _LARGEST_STD**2) + np.eye(6) * floor_m**2
    return grown


def of_blindness(twist: F64 | None, seconds: float) -> F64:
    """Covariance (6, 6) of where a sensor has gone since nothing is known of it.

    It may have gone on or come back, so what the velocity before would have made is one standard
    deviation, along every axis; a sensor that stood may have been carried off too.

    Args:
        twist: (6,) linear (m/s) and angular (rad/s) velocity before, None = it was never known.
        seconds: time since then.
    """
    speed = _FIRST_SPEED
    if twist is not None:
        speed = _SLOW + np.array([np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:])])
    return np.diag(np.repeat(np.minimum(speed * seconds, _LARGEST_STD) ** 2, 3))


def along(unheld: F64, twist: F64 | None, since_s: float, until_s: float) -> F64:
    """Covariance (6, 6) added from scan to scan along directions that nothing holds.

    Args:
        unheld: (6, 6) projection onto them (`Fit.unheld`).
        twist: (6,) velocity when they were last held, None = it was never known.
        since_s: seconds since then, of the scan before.
        until_s: the same of this one.
    """
    grown = of_blindness(twist, until_s) - of_blindness(twist, since_s)
    covariance: F64 = unheld @ grown @ unheld
    return covariance


def weak_direction(unheld: F64) -> F64 | None:
    """Unit direction (3,), odom axes, of the position that is held least; None = all are held."""
    values, vectors = np.linalg.eigh(unheld[:3, :3])
    return vectors[:, -1] if values[-1] > _WEAK else None


def of_twist(pose_covariance: F64, T_odom_sensor: F64, dt_s: float) -> F64:
    """Covariance (6, 6) of a twist in the sensor frame.

    The twist comes from the difference of two poses; their errors are taken as equal and
    independent.

    Args:
        pose_covariance: (6, 6) odom axes.
        T_odom_sensor: (4, 4) the pose.
        dt_s: seconds between the two poses; 0 = unknown velocity.
    """
    if dt_s <= 0.0 or pose_covariance[0, 0] >= LOST_VARIANCE:
        return lost()
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = T_odom_sensor[:3, :3].T
    covariance: F64 = 2.0 * turn @ pose_covariance @ turn.T / dt_s**2
    return covariance

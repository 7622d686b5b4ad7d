# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Preprocessing: what the sensor is, range limits, deskew by constant velocity, thinning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.jit import compiled, compiled_fast
from hybridreg_ros.odometry.map.thinning import first_per_voxel, means_of, occupied, voxel_of
from hybridreg_ros.odometry.preprocessed import PreprocessedScan

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.core.scan import Scan
    from hybridreg_ros.odometry.config import OdometryConfig, PreprocessConfig

_VOXEL_PER_RANGE = {'depth': 0.022, 'lidar': 0.035}
_DIRECTION = 0.035
"""Edge of the cells, on the unit sphere, within which directions count as one: two degrees."""
_LONGEST_SCAN_S = 1.0
_NOISE_RANGE_SQ = 2.0
"""Squared range, m^2, up to which the pose rather than the noise of a depth camera limits what a
point tells: 3 mm against 1.5 mm per squared metre."""
_ENOUGH = {'depth': 4500, 'lidar': 2500}
"""Points wanted for a registration; finer cubes of a lidar would hold more of the same rings."""
_MOST = {'depth': 5000, 'lidar': 2500}
"""Points registered at most. 2,500 of a lidar's 4,600 take half the time, and ATE of six lidar
sequences is 1.04 times as large (docs/lab/2026-11-29-step-time.md)."""
_THINNING = 0.5
"""Edge of the cubes of which map, mask and network get one point each, in voxels."""
_THINNED = 20_000
"""Points that this leaves of a scan, about, at most; else the cubes are larger: 21,000 instead of
35,000 points of an HDL-64 give the same ATE (docs/lab/2026-11-29-three-quarters.md)."""
_INDEPENDENT = 2500
"""Of more points than this, found by finer cubes, the further ones repeat what the others say."""
_DEFAULT_RANGES_M = {'depth': (0.2, 8.0), 'lidar': (0.5, 100.0)}

_SMALLEST_M = {'depth': 0.02, 'lidar': 0.06}
"""Smallest voxel: a lidar's noise is 0.01 m or more however near it measures, and planes of
smaller cubes follow its rings (docs/lab/2026-11-29-what-the-world-sends.md)."""
_DEPTH_REACH_M = 10.0
_FAR_SHARE = 0.02
"""Depth cameras measure hardly anything so far away, where their noise is a tenth of a metre or
more; a stray point may say so."""
_OUTGROWN = 4.0
"""Voxels that fit are so many times as large once a scene has become another one: a step between
rooms or from a wall to a hall makes them up to three times as large."""


@dataclass(frozen=True)
class SensorModel:
    """What the front end knows about the sensor, decided on a usable scan.

    Attributes:
        kind: 'depth' (looks one way) or 'lidar' (looks around).
        voxel_size_m: edge of a map voxel.
        min_range_m: nearer points are ignored.
        max_range_m: farther points are ignored.
        thinning_m: edge of the cubes that thin a scan for map, mask and network.
    """

    kind: str
    voxel_size_m: float
    min_range_m: float
    max_range_m: float
    thinning_m: float

    def outgrown_by(self, now: SensorModel) -> bool:
        """Whether what a later scan shows calls for another map: far larger, or a lidar after all.

        A smaller scene does not: a cover before the sensor is one.
        """
        lidar = self.kind == 'depth' and now.kind == 'lidar'
        return lidar or now.voxel_size_m > _OUTGROWN * self.voxel_size_m


def recognise_sensor(
    points: NDArray[np.float32], config: OdometryConfig, thins: bool = True
) -> SensorModel:
    """Decide what the config leaves open from one scan.

    A sensor is a depth camera when all its points lie within 75 degrees of their mean direction
    and next to none is beyond the reach of such cameras; a lidar may look ahead only, too.

    Args:
        points: (N, 3) float32, sensor frame, metres, N > 0.
        config: settings; 0 and 'auto' are decided here.
        thins: whether `thinning_m` follows the number of points; else they are some of a scan.
    """
    some = points[:: max(1, len(points) // 20_000)].astype(np.float64)
    ranges = np.linalg.norm(some, axis=1)
    # A return at 1e9 m or at the sensor's own housing must not decide anything.
    sane = (ranges > 0.05) & (ranges < 1000.0)
    directions = some[sane] / ranges[sane, None]
    kind = config.sensor
    if kind == 'auto':
        mean = directions.mean(axis=0) if len(directions) else np.zeros(3)
        length = float(np.linalg.norm(mean))
        inside = (
            directions @ (mean / length) > np.cos(np.deg2rad(75.0)) if length > 0.2 else [False]
        )
        far = np.mean(ranges[sane] > _DEPTH_REACH_M) if sane.any() else 0.0
        kind = 'depth' if np.mean(inside) > 0.995 and far < _FAR_SHARE else 'lidar'
    low, high = _DEFAULT_RANGES_M[kind]
    low = config.preprocess.min_range_m or low
    high = config.preprocess.max_range_m or high
    inside_limits = (ranges > low) & (ranges < high)
    usual = 0.1 * high
    if inside_limits.any():
        of_points = float(np.median(ranges[inside_limits]))
        usual = usual_range(some[inside_limits]) if kind == 'lidar' else of_points
    voxel = config.voxel_size_m or round(
        float(np.clip(_VOXEL_PER_RANGE[kind] * usual, _SMALLEST_M[kind], 1.0)), 3
    )
    thinning = _THINNING * voxel
    if not thins:
        return SensorModel(kind, voxel, low, high, thinning)
    seen = points[_in_range(points, low * low, high * high)]
    many = len(first_per_voxel(seen, thinning)) / _THINNED
    thinning *= max(1.0, many) ** 0.5  # points lie on surfaces
    return SensorModel(kind, voxel, low, high, thinning)


def usual_range(points: NDArray[np.float64]) -> float:
    """Median range of points (N, 3), sensor frame, metres, in which every direction counts alike.

    As the sensor measures, each direction has as many points as any other. Of a cloud that was
    thinned by cubes afterwards, most points are far away, though most directions are not.

    Args:
        points: N > 0, none of them at the sensor.
    """
    ranges = np.linalg.norm(points, axis=1)
    everywhere = np.ones(len(points), np.bool_)
    *_, counts, cell = occupied(points / ranges[:, None], _DIRECTION, everywhere)
    order = np.argsort(ranges)
    share = np.cumsum(1.0 / counts[cell[order]])
    return float(ranges[order[np.searchsorted(share, 0.5 * share[-1])]])


def preprocess(
    scan: Scan, sensor: SensorModel, config: PreprocessConfig, twist: NDArray[np.float64]
) -> PreprocessedScan:
    """Limit ranges, undo the motion during the scan, thin.

    Args:
        scan: the scan.
        sensor: limits and voxel size.
        config: settings.
        twist: (6,) linear (m/s) and angular (rad/s) velocity, sensor frame, for the deskew.
    """
    instant_s, reported_s = instants(scan, config)
    points, deskewed = scan.points, instant_s != reported_s
    if deskewed and scan.times is not None and np.any(twist):
        points = deskew(points, scan.times, twist, instant_s)
    usable = _in_range(points, sensor.min_range_m**2, sensor.max_range_m**2)
    member = _every_kth(usable, config.max_points)
    table, slots, _, map_rows, _, cube = occupied(points, sensor.thinning_m, member)
    if member is not usable:
        cube = voxel_of(points, sensor.thinning_m, usable, table, slots)
    means, counts = means_of(points, cube, len(map_rows))
    found, share = _for_registration(points[map_rows], sensor, config)
    icp_rows = map_rows[found]
    most = _MOST[sensor.kind]
    if len(icp_rows) > most:
        icp_rows = icp_rows[np.arange(most) * len(icp_rows) // most]
    wanted = deskewed and config.intra_scan
    times = scan.times - instant_s if wanted and scan.times is not None else None
    thinned = map_rows, icp_rows, means, counts, cube
    when = instant_s, reported_s, twist, times
    return PreprocessedScan(points, usable, *thinned, deskewed, *when, share)


def _for_registration(
    points: NDArray[np.float32], sensor: SensorModel, config: PreprocessConfig
) -> tuple[NDArray[np.int64], float]:
    """Rows of the points (M, 3) that are registered: one per cube, a finer one where few fill it.

    Near a wall a depth camera fills few cubes, and just there little holds its pose.

    Returns:
        The rows, and the share of them that counts as independent: neighbours in a depth image
        err alike, so more of them make the pose better, but not by as much as they seem to.
    """
    size = config.icp_thinning * sensor.voxel_size_m
    rows = first_per_voxel(points, size)
    enough = _ENOUGH[sensor.kind]
    if not 0 < len(rows) < enough:
        return rows, 1.0
    independent = max(len(rows), _INDEPENDENT)
    finer = size * np.sqrt(len(rows) / enough)  # points lie on surfaces
    rows = first_per_voxel(points, max(finer, sensor.thinning_m))
    return rows, min(1.0, independent / len(rows))


def _every_kth(member: NDArray[np.bool_], most: int) -> NDArray[np.bool_]:
    """Every k-th of the members (N,) bool, so that at most so many are left."""
    count = int(np.count_nonzero(member))
    if count <= most:
        return member
    thinned = np.zeros(len(member), np.bool_)
    thinned[np.flatnonzero(member)[:: -(-count // most)]] = True
    return thinned


def certainty(points: NDArray[np.floating], sensor: SensorModel) -> NDArray[np.float64]:
    """Weight (N,) in (0, 1] of measured points in a mean: inverse variance, 1 for the best.

    The noise of a depth camera grows with the square of the range; that of a lidar does not.

    Args:
        points: (N, 3), sensor frame, metres.
        sensor: its kind.
    """
    if sensor.kind != 'depth':
        return np.ones(len(points))
    squared = np.einsum('ij,ij->i', points, points).astype(np.float64)
    weights: NDArray[np.float64] = 1.0 / (1.0 + (squared / _NOISE_RANGE_SQ) ** 2)
    return weights


def deskew(
    points: NDArray[np.float32],
    times: NDArray[np.float64],
    twist: NDArray[np.float64],
    instant_s: float,
) -> NDArray[np.float32]:
    """Points as seen from where the sensor was at one instant, if it moved evenly.

    Args:
        points: (N, 3) float32, each in the sensor frame at its own time, metres.
        times: (N,) seconds.
        twist: (6,) linear (m/s) and angular (rad/s) velocity, sensor frame.
        instant_s: the instant, on the same clock as `times`.

    Returns:
        (N, 3) float32, sensor frame at the instant.
    """
    moved: NDArray[np.float32] = _deskew(
        points, times - instant_s, twist[:3].copy(), twist[3:].copy()
    )
    return moved


def instants(scan: Scan, config: PreprocessConfig) -> tuple[float, float]:
    """When a scan is registered and when its pose is reported, seconds after its stamp.

    A scan with believable times is registered at the mean time of its points, because there a
    wrong velocity does not shift the cloud as a whole: at the start or the end it would, the next
    velocity would be wrong the other way round, and the pose would swing.

    Args:
        scan: the scan.
        config: whether to deskew, and the instant to report (`deskew_to`).
    """
    if not config.deskew or scan.times is None or not believable(scan.times):
        return 0.0, 0.0
    reported = {'stamp': 0.0, 'start': scan.times.min(), 'end': scan.times.max()}
    return float(scan.times.mean()), float(reported[config.deskew_to])


def believable(times: NDArray[np.float64]) -> bool:
    """Whether per-point times (seconds) can be those of one scan."""
    if len(times) == 0 or not np.isfinite(times).all():
        return False
    span = float(times.max() - times.min())
    return 0.0 < span <= _LONGEST_SCAN_S and float(np.abs(times).max()) <= 2.0 * _LONGEST_SCAN_S


@compiled_fast
def _in_range(points, low_sq, high_sq):  # type: ignore[no-untyped-def]
    flat, inside = np.ascontiguousarray(points).reshape(-1), np.empty(len(points), np.bool_)
    for row in range(len(inside)):  # without branches, so that it fills vector registers
        x, y, z = float(flat[3 * row]), float(flat[3 * row + 1]), float(flat[3 * row + 2])
        r = x * x + y * y + z * z
        inside[row] = (low_sq <= r) & (r <= high_sq)
    return inside


@compiled
def _deskew(points, times, v, w):  # type: ignore[no-untyped-def]
    """Each point moved by exp(twist * its time): Rodrigues' formula with one axis for all."""
    moved = np.empty_like(points)
    rate = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    kx, ky, kz = 0.0, 0.0, 0.0
    if rate > 1e-9:
        kx, ky, kz = w[0] / rate, w[1] / rate, w[2] / rate
    # k x v and k x (k x v) give the curved part of the path.
    ax, ay, az = ky * v[2] - kz * v[1], kz * v[0] - kx * v[2], kx * v[1] - ky * v[0]
    bx, by, bz = ky * az - kz * ay, kz * ax - kx * az, kx * ay - ky * ax
    for row in range(len(points)):
        s = times[row]
        angle = rate * s
        sin, cos = np.sin(angle), np.cos(angle)
        f1, f2 = 0.5 * s * angle, s * angle * angle / 6.0
        if abs(angle) > 1e-5:
            f1, f2 = (1.0 - cos) / rate, s - sin / rate
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        cx, cy, cz = ky * z - kz * y, kz * x - kx * z, kx * y - ky * x
        dx, dy, dz = ky * cz - kz * cy, kz * cx - kx * cz, kx * cy - ky * cx
        moved[row, 0] = x + sin * cx + (1.0 - cos) * dx + s * v[0] + f1 * ax + f2 * bx
        moved[row, 1] = y + sin * cy + (1.0 - cos) * dy + s * v[1] + f1 * ay + f2 * by
        moved[row, 2] = z + sin * cz + (1.0 - cos) * dz + s * v[2] + f1 * az + f2 * bz
    return moved

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Range images: what a scan saw in each direction, and where other points stand against it."""

# ruff: noqa: PLR0913, PLR0917 (kernels take plain arrays, named in `VoxelLevel`)
from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.jit import compiled
from hybridreg_ros.core.pages import paged

if TYPE_CHECKING:
    from numpy.typing import NDArray

UNSEEN, FRONT, ON, BEHIND = 0, 1, 2, 3
"""Where a point stands: direction not seen, in seen free space, on a surface, hidden by one."""

_MOST_POINTS = 150_000
_POINTS_PER_PIXEL = 2
_FINEST_RAD = np.deg2rad(0.4)
_COARSEST_RAD = np.deg2rad(4.0)
_HIDDEN = 2.0
"""Standard deviations behind a surface at which it hides a point."""
_FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Pixels:
    """How directions of one sensor map to pixels: azimuth and elevation about a main axis.

    Attributes:
        basis: (3, 3) rows forward, left, up of the view in the sensor frame.
        azimuth_rad: left-most azimuth, rad; pixels count to the other side.
        elevation_rad: lowest elevation, rad.
        step_rad: (2,) width and height of a pixel, rad.
        width: pixels per row.
        height: rows.
        wraps: whether the row closes on itself (full turn).
    """

    basis: NDArray[np.float64]
    azimuth_rad: float
    elevation_rad: float
    step_rad: NDArray[np.float64]
    width: int
    height: int
    wraps: bool


def view_of(points: NDArray[np.floating], kind: str) -> Pixels:
    """Choose a view from one scan: pixels as fine as leaves most of them filled.

    Args:
        points: (N, 3), sensor frame, metres, N > 0.
        kind: 'depth' (main axis = mean direction) or 'lidar' (main axis x, z up).
    """
    some = np.asarray(points[:: max(1, len(points) // _MOST_POINTS)], np.float64)
    basis = np.eye(3)
    if kind == 'depth':
        forward = (some / np.linalg.norm(some, axis=1, keepdims=True)).mean(axis=0)
        forward /= np.linalg.norm(forward)
        side = np.cross(np.eye(3)[np.argmin(np.abs(forward))], forward)
        side /= np.linalg.norm(side)
        basis = np.stack([forward, side, np.cross(forward, side)])
    rotated = some @ basis.T
    azimuth = np.arctan2(rotated[:, 1], rotated[:, 0])
    elevation = np.arctan2(rotated[:, 2], np.hypot(rotated[:, 0], rotated[:, 1]))
    wraps = kind == 'lidar'
    az_low, az_high = (-np.pi, np.pi) if wraps else (azimuth.min(), azimuth.max())
    el_low, el_high = np.percentile(elevation, [0.5, 99.5])
    step = _pixel(azimuth, elevation)
    margin = 2.0 * step
    if not wraps:
        az_low, az_high = az_low - margin[0], az_high + margin[0]
    el_low, el_high = el_low - margin[1], el_high + margin[1]
    width = max(3, round((az_high - az_low) / step[0]))
    step[0] = (az_high - az_low) / width
    height = max(3, int(np.ceil((el_high - el_low) / step[1])))
    return Pixels(basis, float(az_low), float(el_low), step, width, height, wraps)


def _pixel(azimuth: NDArray[np.float64], elevation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixel size (2,), rad: grown, the emptier side first, until seen columns have few holes."""
    step = np.array([_FINEST_RAD, _FINEST_RAD])
    while step.max() < _COARSEST_RAD:
        column = np.floor(azimuth / step[0]).astype(np.int64)
        row = np.floor(elevation / step[1]).astype(np.int64)
        filled = len(np.unique(column * 100_003 + row))
        columns = np.unique(column)
        span = np.percentile(elevation, 97.5) - np.percentile(elevation, 2.5)
        if filled >= 0.75 * len(columns) * max(1.0, span / step[1]):
            break
        step[1 if step[1] <= 2.0 * step[0] else 0] *= 1.25
    return step


class RangeImage:
    """Nearest and farthest range per direction of one scan, and the pose it was taken from.

    Args:
        points: (N, 3), sensor frame, metres.
        view: how directions map to pixels.
        T_odom_sensor: (4, 4) pose of the scan.
        rows: (R,) int64, the points to draw; None for all.
    """

    def __init__(
        self,
        points: NDArray[np.floating],
        view: Pixels,
        T_odom_sensor: NDArray[np.float64],
        rows: NDArray[np.int64] | None = None,
    ) -> None:
        self.view = view
        self.T_odom_sensor = T_odom_sensor
        count = len(points) if rows is None else len(rows)
        step = max(1, count // (_POINTS_PER_PIXEL * view.width * view.height))
        near = np.full((view.height, view.width), np.inf, np.float32)
        far = np.zeros((view.height, view.width), np.float32)
        some = points[::step] if rows is None else points[rows[::step]]
        _draw(some, *_geometry(view), near, far)
        # A point counts as off a surface only when it is off in the 3x3 pixels around it, so that
        # slanted surfaces and edges do not look like things that moved.
        filled = np.flatnonzero((far > 0.0).any(axis=1))
        self._rows = (int(filled[0]), int(filled[-1])) if len(filled) else (0, -1)
        self._near, self._far = _widen(near, far, view.wraps)
        self._inside = _inside(far > 0.0, view.wraps)

    def paged(self) -> RangeImage:
        """The same image in pages of its own (`core.pages`), for one that is kept for long."""
        other = copy(self)
        other._near, other._far = paged(np.stack([self._near, self._far]))
        other._inside = paged(self._inside)
        return other

    def stand(
        self,
        points: NDArray[np.floating],
        T_odom_sensor: NDArray[np.float64],
        tolerance_m: float,
        tolerance_share: float,
        strict: bool = False,
    ) -> NDArray[np.int8]:
        """Where points of another scan stand against this one.

        Args:
            points: (N, 3), the other scan's sensor frame, metres.
            T_odom_sensor: (4, 4) pose of the other scan.
            tolerance_m: slack in range, metres.
            tolerance_share: further slack as a share of the range.
            strict: take the rim of the view, where the slope of a surface cannot be told, as
                unseen.

        Returns:
            (N,) int8 of UNSEEN, FRONT, ON, BEHIND.
        """
        T = se3.inverse(self.T_odom_sensor) @ T_odom_sensor
        out = np.zeros(len(points), np.int8)
        _stand(
            points,
            T[:3, :3].copy(),
            T[:3, 3].copy(),
            *_geometry(self.view),
            self._near,
            self._far,
            tolerance_m,
            tolerance_share,
            self._inside,
            strict,
            out,
        )
        return out

    def look(
        self,
        points: NDArray[np.float64],
        T_odom_sensor: NDArray[np.float64],
        now: RangeImage,
        noise: tuple[float, float, float],
        age_s: float,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """How far points of a later scan are off what this one saw, and if that has gone since.

        Args:
            points: (N, 3) float64, the later scan's sensor frame, metres.
            T_odom_sensor: (4, 4) pose of the later scan.
            now: what the later scan saw, in the same view.
            noise: standard deviation of a range: metres, per metre, and per square metre.
            age_s: seconds between the scans.

        Returns:
            margin: (N,) standard deviations before (+) or behind (-) the surface; 0 on it,
                infinite where nothing came back, NaN in directions not seen.
            speed: (N,) m/s from the surface that hid the point to the point, where the later scan
                sees through that surface; else -1.
        """
        T = se3.inverse(self.T_odom_sensor) @ T_odom_sensor
        margin = np.empty(len(points), np.float32)
        speed = np.empty(len(points), np.float32)
        _look(
            se3.apply(T, points),
            T[:3, :3].T.copy(),
            T[:3, 3].copy(),
            *_geometry(self.view),
            (self._near, self._far, self._inside, self._rows),
            (now._near, now._far),
            noise,
            age_s,
            margin,
            speed,
        )
        return margin, speed


def _inside(filled: NDArray[np.bool_], wraps: bool) -> NDArray[np.bool_]:
    """Pixels with seen ones on both sides in their column and, unless it wraps, in their row."""
    inside = np.zeros_like(filled)
    for axis in (0,) if wraps else (0, 1):
        before = np.maximum.accumulate(filled, axis=axis)
        after = np.flip(np.maximum.accumulate(np.flip(filled, axis), axis=axis), axis)
        between = np.zeros_like(filled)
        if axis == 0:
            between[1:-1] = before[:-2] & after[2:]
        else:
            between[:, 1:-1] = before[:, :-2] & after[:, 2:]
        inside = between if axis == 0 else inside & between
    return inside


def _geometry(
    view: Pixels,
) -> tuple[NDArray[np.float64], float, float, NDArray[np.float64], bool]:
    return view.basis, view.azimuth_rad, view.elevation_rad, view.step_rad, view.wraps


@compiled
def _pixel_of(x, y, z, basis, azimuth, elevation, step):  # type: ignore[no-untyped-def]
    """Range, column and row of a direction; they may lie outside the image."""
    f = basis[0, 0] * x + basis[0, 1] * y + basis[0, 2] * z
    s = basis[1, 0] * x + basis[1, 1] * y + basis[1, 2] * z
    u = basis[2, 0] * x + basis[2, 1] * y + basis[2, 2] * z
    flat = np.sqrt(f * f + s * s)
    column = int(np.floor((np.arctan2(s, f) - azimuth) / step[0]))
    row = int(np.floor((np.arctan2(u, flat) - elevation) / step[1]))
    return np.sqrt(flat * flat + u * u), column, row


@compiled
def _draw(points, basis, azimuth, elevation, step, wraps, near, far):  # type: ignore[no-untyped-def]
    height, width = near.shape
    for i in range(len(points)):
        r, column, row = _pixel_of(
            points[i, 0], points[i, 1], points[i, 2], basis, azimuth, elevation, step
        )
        if wraps:
            column %= width
        if column < 0 or row < 0 or column >= width or row >= height:
            continue
        near[row, column] = min(near[row, column], r)
        far[row, column] = max(far[row, column], r)


@compiled
def _widen(near, far, wraps):  # type: ignore[no-untyped-def]
    """Nearest and farthest range within one pixel around each pixel."""
    height, width = near.shape
    low = np.full_like(near, np.inf)
    high = np.zeros_like(far)
    for v in range(height):
        for u in range(width):
            if far[v, u] == 0.0:
                continue
            for dv in range(-1, 2):
                for du in range(-1, 2):
                    row, column = v + dv, u + du
                    if wraps:
                        column %= width
                    if row < 0 or column < 0 or row >= height or column >= width:
                        continue
                    low[row, column] = min(low[row, column], near[v, u])
                    high[row, column] = max(high[row, column], far[v, u])
    return low, high


@compiled
def _stand(  # type: ignore[no-untyped-def]
    points,
    R,
    t,
    basis,
    azimuth,
    elevation,
    step,
    wraps,
    near,
    far,
    slack,
    share,
    inside,
    strict,
    out,
):
    height, width = near.shape
    B = basis @ R
    o = basis @ t
    for i in range(len(points)):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        f = B[0, 0] * px + B[0, 1] * py + B[0, 2] * pz + o[0]
        s = B[1, 0] * px + B[1, 1] * py + B[1, 2] * pz + o[1]
        u = B[2, 0] * px + B[2, 1] * py + B[2, 2] * pz + o[2]
        out[i] = UNSEEN
        flat = np.sqrt(f * f + s * s)
        row = int(np.floor((np.arctan2(u, flat) - elevation) / step[1]))
        if row < 0 or row >= height:
            continue
        column = int(np.floor((np.arctan2(s, f) - azimuth) / step[0]))
        if wraps:
            column %= width
        if column < 0 or column >= width:
            continue
        high = far[row, column]
        if high == 0.0 or (strict and not inside[row, column]):
            continue
        low = near[row, column]
        r = np.sqrt(flat * flat + u * u)
        tolerance = slack + share * r
        if r < low - tolerance:
            out[i] = FRONT
        elif r > high + tolerance:
            out[i] = BEHIND
        else:
            out[i] = ON


@compiled
def _look(  # type: ignore[no-untyped-def]
    points, R, t, basis, azimuth, elevation, step, wraps, then, now, noise, age_s, margin, speed
):
    """The kernel of `RangeImage.look`; points in the sensor frame of the image, R its rotation."""
    near, far, inside, (lowest, highest) = then
    height, width = near.shape
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        margin[i], speed[i] = np.nan, -1.0
        r, column, row = _pixel_of(x, y, z, basis, azimuth, elevation, step)
        if wraps:
            column %= width
        if column < 0 or row < 0 or column >= width or row >= height:
            continue
        low, high = near[row, column], far[row, column]
        if high == 0.0:
            if row >= lowest and row <= highest:
                margin[i] = np.inf
            continue
        if not inside[row, column]:
            continue
        sigma = noise[0] + noise[1] * r + noise[2] * r * r
        margin[i] = max(low - r, 0.0) / sigma - max(r - high, 0.0) / sigma
        if margin[i] >= -_HIDDEN:
            continue
        share = high / r
        x, y, z = x * share - t[0], y * share - t[1], z * share - t[2]
        q, column, row = _pixel_of(
            R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
            R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
            R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
            basis, azimuth, elevation, step,
        )  # fmt: skip
        if wraps:
            column %= width
        if column < 0 or row < 0 or column >= width or row >= height or now[1][row, column] == 0.0:
            continue
        sigma = noise[0] + noise[1] * q + noise[2] * q * q
        if now[0][row, column] - q > _HIDDEN * sigma:
            speed[i] = (r - high) / age_s

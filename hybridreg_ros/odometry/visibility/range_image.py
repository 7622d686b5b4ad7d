# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Range images: what a scan saw in each direction, and where other points stand against it."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.jit import compiled, compiled_fast
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

    @cached_property
    def own(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """How points of its own frame become pixels, for kernels."""
        return _sight(self, np.eye(4))


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
        member: (N,) bool, the points to draw; None for all.
    """

    def __init__(
        self,
        points: NDArray[np.floating],
        view: Pixels,
        T_odom_sensor: NDArray[np.float64],
        member: NDArray[np.bool_] | None = None,
    ) -> None:
        self.view = view
        self.T_odom_sensor = T_odom_sensor
        count = len(points) if member is None else int(np.count_nonzero(member))
        step = max(1, count // (_POINTS_PER_PIXEL * view.width * view.height))
        ranges, pixels = _seen(points[::step], view, np.eye(4))
        self._drawn: tuple[int, NDArray[np.float32], NDArray[np.int32]] = step, ranges, pixels
        self._draw(None if member is None else member[::step])

    def _draw(self, member: NDArray[np.bool_] | None) -> None:
        _, ranges, pixels = self._drawn
        near = np.full((self.view.height, self.view.width), np.inf, np.float32)
        far = np.zeros((self.view.height, self.view.width), np.float32)
        shown = pixels if member is None else np.where(member, pixels, np.int32(-1))
        _draw(ranges, shown, near.ravel(), far.ravel())
        # A point counts as off a surface only when it is off in the 3x3 pixels around it, so that
        # slanted surfaces and edges do not look like things that moved.
        filled = np.flatnonzero((far > 0.0).any(axis=1))
        self._rows = (int(filled[0]), int(filled[-1])) if len(filled) else (0, -1)
        self._near, self._far = _widen(near, far, self.view.wraps)
        self._inside = _inside(far, self.view.wraps)
        self._saw: NDArray[np.float32] | None = None

    def only(self, member: NDArray[np.bool_]) -> RangeImage:
        """The image of some (N,) of the points that were given to this one, not `kept` before."""
        other = copy(self)
        other._draw(member[:: self._drawn[0]])
        return other

    def kept(self) -> RangeImage:
        """The same image without the points it was drawn from."""
        other = copy(self)
        other._drawn = 1, np.zeros(0, np.float32), np.zeros(0, np.int32)
        return other

    def paged(self) -> RangeImage:
        """As `kept`, in pages of its own (`core.pages`), for one that is kept for long."""
        other = self.kept()
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
        ranges, pixels = _seen(points, self.view, T)
        out = np.zeros(len(points), np.int8)
        inside = self._inside if strict else self._far > 0.0
        images = self._near.ravel(), self._far.ravel(), inside.ravel()
        _stand(ranges, pixels, images, tolerance_m, tolerance_share, out)
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
        margin, speed = np.empty((2, len(points)), np.float32)
        at, origin = _seen(points, self.view, T), tuple(se3.inverse(T)[:3, 3].tolist())
        if self._saw is None:
            self._saw = _seen_through(self._near, self._far, self._inside, *self._rows)
        seen_now = now._near.ravel(), now._far.ravel()
        view = origin, *self.view.own
        _look(points, at, view, self._saw, seen_now, noise, age_s, (margin, speed))
        return margin, speed


def _sight(
    view: Pixels, T_view_points: NDArray[np.float64]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """For `_place`: rows of the transform to forward, left, up (12); how angles become pixels."""
    to_view = (view.basis @ T_view_points[:3]).ravel().tolist()
    turn = view.width if view.wraps else 0
    low, scale = (view.azimuth_rad, view.elevation_rad), (1.0 / view.step_rad).tolist()
    return tuple(to_view), (*low, *scale, float(view.width), float(view.height), float(turn))


def _seen(
    points: NDArray[np.floating], view: Pixels, T_view_points: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Range (N,), metres, and pixel (N,) of points as a sensor sees them; -1 outside its view."""
    ranges = np.empty(len(points), np.float32)
    pixels = np.empty(len(points), np.int32)
    _project(np.ascontiguousarray(points).ravel(), *_sight(view, T_view_points), ranges, pixels)
    return ranges, pixels


@compiled_fast
def _angle(y, x):  # type: ignore[no-untyped-def]
    """Direction of (x, y), rad, within 1.1e-5 (Abramowitz and Stegun, 4.4.47)."""
    a, b = abs(x), abs(y)
    small = min(a, b) / max(a, b, np.float32(1e-12))
    q = small * small
    r = np.float32(0.0208351) * q - np.float32(0.0851330)
    r = r * q + np.float32(0.1801410)
    r = r * q - np.float32(0.3302995)
    r = (r * q + np.float32(0.9998660)) * small
    r = np.float32(np.pi / 2) - r if b > a else r
    r = np.float32(np.pi) - r if x < np.float32(0.0) else r
    return -r if y < np.float32(0.0) else r


@compiled_fast
def _place(x, y, z, to_view, grid):  # type: ignore[no-untyped-def]
    """Range and pixel of a point; in float32, rays at the borders of pixels fall anywhere."""
    f = to_view[0] * x + to_view[1] * y + to_view[2] * z + to_view[3]
    s = to_view[4] * x + to_view[5] * y + to_view[6] * z + to_view[7]
    u = to_view[8] * x + to_view[9] * y + to_view[10] * z + to_view[11]
    azimuth, elevation, across, up, width, height, turn = grid
    square = f * f + s * s
    column = np.floor((_angle(s, f) - azimuth) * across)
    row = np.floor((_angle(u, np.sqrt(square)) - elevation) * up)
    column = column - turn if column >= width else column
    column = column + turn if column < 0.0 else column
    within = (column >= 0.0) & (row >= 0.0) & (column < width) & (row < height)
    return np.sqrt(square + u * u), np.int32(row * width + column if within else -1.0)


@compiled_fast
def _project(points, to_view, grid, ranges, pixels):  # type: ignore[no-untyped-def]
    """The kernel of `_seen`; points are flat, so that the loop fits vector registers."""
    for i in range(len(pixels)):
        x, y, z = points[3 * i], points[3 * i + 1], points[3 * i + 2]
        ranges[i], pixels[i] = _place(np.float64(x), np.float64(y), np.float64(z), to_view, grid)


@compiled
def _draw(ranges, pixels, near, far):  # type: ignore[no-untyped-def]
    for i in range(len(pixels)):
        pixel, r = pixels[i], ranges[i]
        if pixel >= 0:
            near[pixel] = min(near[pixel], r)
            far[pixel] = max(far[pixel], r)


@compiled
def _widen(near, far, wraps):  # type: ignore[no-untyped-def]
    """Nearest and farthest range within one pixel around each pixel."""
    height, width = near.shape
    low, high = np.empty_like(near), np.empty_like(far)
    a, b = np.empty(width + 2, near.dtype), np.empty(width + 2, far.dtype)
    for v in range(height):
        below, above = max(v - 1, 0), min(v + 1, height - 1)
        for u in range(width):
            a[u + 1] = min(near[below, u], near[v, u], near[above, u])
            b[u + 1] = max(far[below, u], far[v, u], far[above, u])
        left, right = (width, 1) if wraps else (1, width)
        a[0], b[0] = a[left], b[left]
        a[width + 1], b[width + 1] = a[right], b[right]
        for u in range(width):
            low[v, u] = min(a[u], a[u + 1], a[u + 2])
            high[v, u] = max(b[u], b[u + 1], b[u + 2])
    return low, high


@compiled
def _inside(far, wraps):  # type: ignore[no-untyped-def]
    """Pixels with seen ones on both sides in their column and, unless it wraps, in their row."""
    height, width = far.shape
    inside = np.empty(far.shape, np.bool_)
    first, last = np.full(width, height), np.full(width, -1)
    for v in range(height):
        for u in range(width):
            seen = far[v, u] > 0.0
            first[u] = min(first[u], v) if seen else first[u]
            last[u] = v if seen else last[u]
    for v in range(height):
        left, right = -1, width
        if not wraps:
            left, right = width, -1
            for u in range(width):
                seen = far[v, u] > 0.0
                left = min(left, u) if seen else left
                right = u if seen else right
        for u in range(width):
            inside[v, u] = (first[u] < v) & (v < last[u]) & (left < u) & (u < right)
    return inside


@compiled
def _seen_through(near, far, inside, lowest, highest):  # type: ignore[no-untyped-def]
    """Ranges (2, H * W) for `_look`: infinite if nothing came back, NaN if nothing is known."""
    saw = np.full((2, *near.shape), np.nan, np.float32)
    for v in range(len(near)):
        empty = np.inf if lowest <= v <= highest else np.nan
        for u in range(near.shape[1]):
            if far[v, u] == 0.0:
                saw[0, v, u], saw[1, v, u] = empty, empty
            elif inside[v, u]:
                saw[0, v, u], saw[1, v, u] = near[v, u], far[v, u]
    return saw.reshape(2, -1)


@compiled
def _stand(ranges, pixels, images, slack, share, out):  # type: ignore[no-untyped-def]
    near, far, inside = images
    for i in range(len(pixels)):
        pixel, r = pixels[i], ranges[i]
        if pixel < 0 or not inside[pixel] or far[pixel] == 0.0:
            out[i] = UNSEEN
            continue
        tolerance = slack + share * r
        if r < near[pixel] - tolerance:
            out[i] = FRONT
        elif r > far[pixel] + tolerance:
            out[i] = BEHIND
        else:
            out[i] = ON


@compiled_fast
def _margins(ranges, pixels, near, far, noise, margin):  # type: ignore[no-untyped-def]
    """Standard deviations off what was seen; all in float32 and without a branch, for speed."""
    zero, nan = np.float32(0.0), np.float32(np.nan)
    a, b, c = np.float32(noise[0]), np.float32(noise[1]), np.float32(noise[2])
    for i in range(len(pixels)):
        pixel, r = max(pixels[i], 0), ranges[i]
        off = max(near[pixel] - r, zero) - max(r - far[pixel], zero)
        margin[i] = off / (a + b * r + c * r * r) if pixels[i] >= 0 else nan


@compiled
def _look(points, at, view, saw, now, noise, age_s, out):  # type: ignore[no-untyped-def]
    """The kernel of `RangeImage.look`, by where points (N, 3) were looked for."""
    ranges, pixels = at
    far, (origin, to_view, grid) = saw[1], view
    margin, speed = out
    _margins(ranges, pixels, saw[0], far, noise, margin)
    speed[:] = -1.0
    for i in range(len(pixels)):
        pixel, r = pixels[i], ranges[i]
        if not margin[i] < -_HIDDEN:  # nor if it is NaN
            continue
        share = far[pixel] / r  # what hid it is so far along the way from the origin
        x = origin[0] + share * (points[i, 0] - origin[0])
        y = origin[1] + share * (points[i, 1] - origin[1])
        z = origin[2] + share * (points[i, 2] - origin[2])
        q, there = _place(x, y, z, to_view, grid)
        sigma = noise[0] + noise[1] * q + noise[2] * q * q
        if there >= 0 and now[1][there] > 0.0 and now[0][there] - q > _HIDDEN * sigma:
            speed[i] = (r - far[pixel]) / age_s

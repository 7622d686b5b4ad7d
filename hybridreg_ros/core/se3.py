# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms as 4x4 float64 arrays: exp, log, inverse, interpolation, Kabsch."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from hybridreg_ros.core.jit import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

Real = TypeVar('Real', bound='np.floating[Any]')
_SMALL_ANGLE_RAD = 1e-7


def transform(R: F64, t: F64) -> F64:
    """Build a transform from its parts.

    Args:
        R: (3, 3) rotation.
        t: (3,) translation, metres.

    Returns:
        (4, 4) float64.
    """
    T = np.zeros((4, 4))
    T[:3, :3], T[:3, 3], T[3, 3] = R, t, 1.0
    return T


def inverse(T: F64) -> F64:
    """Inverse of a rigid transform (4, 4); exact up to rounding, no general matrix inverse."""
    result: F64 = inverse_of(_array(T))
    return result


def apply(T_target_source: F64, points: NDArray[Real]) -> NDArray[Real]:
    """Move points from the source to the target frame.

    Args:
        T_target_source: (4, 4).
        points: (N, 3), metres, source frame.

    Returns:
        (N, 3) of the dtype of `points`, target frame.
    """
    moved: NDArray[Real] = _moved(_array(T_target_source), np.ascontiguousarray(points))
    return moved


def hat(w: F64) -> F64:
    """Skew matrix of w (3,), so that its product with v is the cross product w x v."""
    x, y, z = w
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def so3_exp(w: F64) -> F64:
    """Rotation (3, 3) of a rotation vector w (3,), radians (Rodrigues' formula)."""
    R: F64 = rotation_of(_array(w))
    return R


def so3_log(R: F64) -> F64:
    """Rotation vector (3,), radians, of a rotation (3, 3); its norm lies in [0, pi]."""
    w: F64 = turn_of(_array(R))
    return w


def exp(xi: F64) -> F64:
    """Transform (4, 4) of a twist (6,): translation part (metres) first, then rotation (rad)."""
    T: F64 = _exp(_array(xi))
    return T


def log(T: F64) -> F64:
    """Twist (6,) of a transform: translation part (metres) first, then rotation (rad)."""
    xi: F64 = _log(_array(T))
    return xi


def interpolate(T_a: F64, T_b: F64, s: float) -> F64:
    """Transform at share s of the screw motion from T_a (s = 0) to T_b (s = 1)."""
    result: F64 = T_a @ exp(s * log(inverse(T_a) @ T_b))
    return result


def rotation_angle_deg(R: F64) -> float:
    """Angle of a rotation (3, 3) in degrees, in [0, 180]."""
    return math.degrees(math.hypot(*so3_log(R).tolist()))


def orthonormalise(T: F64) -> F64:
    """Nearest rigid transform: the rotation part is projected onto SO(3) by SVD."""
    return transform(_nearest_rotation(_array(T[:3, :3])), T[:3, 3])


def is_rigid(T: NDArray[np.floating], tolerance: float = 1e-4) -> bool:
    """True when T is (4, 4), finite, and its rotation part is a proper rotation."""
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return False
    R = T[:3, :3]
    off = np.abs(R @ R.T - np.eye(3)).max(), np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max()
    return bool(max(off) <= tolerance and np.linalg.det(R) > 0.0)


def kabsch(source: F64, target: F64, weights: F64 | None = None) -> F64:
    """Weighted least-squares rigid alignment (Kabsch 1976, reflection guarded).

    Args:
        source: (N, 3), metres.
        target: (N, 3), metres; row i belongs to row i of `source`.
        weights: (N,) not negative, or None for equal weights.

    Returns:
        T_target_source (4, 4); the identity rotation when all weights are zero.
    """
    w = np.ones(len(source)) if weights is None else np.asarray(weights, dtype=np.float64)
    total = float(w.sum())
    if len(source) == 0 or total <= 0.0:
        return np.eye(4)
    w = w / total
    mu_s, mu_t = w @ source, w @ target
    return from_moments((source - mu_s).T @ ((target - mu_t) * w[:, None]), mu_s, mu_t)


def from_moments(H: F64, mu_s: F64, mu_t: F64) -> F64:
    """Rigid alignment from the moments of matched points (Kabsch 1976, reflection guarded).

    Args:
        H: (3, 3) weighted sum of (source - mu_s) (target - mu_t)^T, any scale.
        mu_s: (3,) weighted mean of the source points, metres.
        mu_t: (3,) that of the target points.

    Returns:
        T_target_source (4, 4).
    """
    T: F64 = aligned(_array(H), _array(mu_s), _array(mu_t))
    return T


def _array(values: NDArray[Any]) -> F64:
    """Values as the kernels take them: float64, rows one after another."""
    return np.ascontiguousarray(values, np.float64)


@compiled
def _moved(T, points):  # type: ignore[no-untyped-def]
    """`apply` to contiguous arrays."""
    out = np.empty_like(points)
    for row in range(len(points)):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        out[row, 0] = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        out[row, 1] = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        out[row, 2] = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    return out


@compiled
def rotation_of(w):  # type: ignore[no-untyped-def]
    """`so3_exp`, for kernels."""
    R = np.empty((3, 3))
    _about(w[0], w[1], w[2], 0, R)
    return R


@compiled
def _about(x, y, z, order, out):  # type: ignore[no-untyped-def]
    """I + a W + b W W into `out` (3, 3), W the skew matrix of (x, y, z).

    Order 0: the rotation by that vector; 1: its left Jacobian (integral over the turn).
    """
    sq = x * x + y * y + z * z
    angle = np.sqrt(sq)
    if angle < _SMALL_ANGLE_RAD:
        a, b = (1.0, 0.5) if order == 0 else (0.5, 1.0 / 6.0)
    elif order == 0:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / sq
    else:
        a, b = (1.0 - np.cos(angle)) / sq, (angle - np.sin(angle)) / (sq * angle)
    _quadratic(x, y, z, a, b, out)


@compiled
def _quadratic(x, y, z, a, b, out):  # type: ignore[no-untyped-def]
    """I + a W + b W W into `out` (3, 3), W the skew matrix of (x, y, z)."""
    out[0, 0], out[1, 1], out[2, 2] = (
        1.0 - b * (y * y + z * z),
        1.0 - b * (x * x + z * z),
        1.0 - b * (x * x + y * y),
    )
    out[0, 1], out[1, 0] = b * x * y - a * z, b * x * y + a * z
    out[0, 2], out[2, 0] = b * x * z + a * y, b * x * z - a * y
    out[1, 2], out[2, 1] = b * y * z - a * x, b * y * z + a * x


@compiled
def turn_of(R):  # type: ignore[no-untyped-def]
    """`so3_log`, for kernels."""
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sin2 = np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    angle = np.arctan2(0.5 * sin2, 0.5 * (trace - 1.0))
    if angle < _SMALL_ANGLE_RAD:
        return 0.5 * w
    if np.pi - angle >= 1e-4:
        return angle / sin2 * w
    # Near pi the antisymmetric part vanishes: the symmetric one gives the axis a,
    # (R + R^T) / 2 = cos(angle) I + (1 - cos(angle)) a a^T.
    cos = np.cos(angle)
    k = 0
    for i in range(1, 3):
        if R[i, i] > R[k, k]:
            k = i
    axis = np.empty(3)
    for i in range(3):
        axis[i] = 0.5 * (R[i, k] + R[k, i]) - (cos if i == k else 0.0)
    length = np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    if axis[0] * w[0] + axis[1] * w[1] + axis[2] * w[2] < 0.0:
        length = -length
    return angle / length * axis


@compiled
def _nearest_rotation(M):  # type: ignore[no-untyped-def]
    """Rotation (3, 3) nearest to a matrix, by SVD, never a reflection."""
    U, _, Vt = np.linalg.svd(M)
    R = np.zeros((3, 3))
    sign = 1.0 if np.linalg.det(U) * np.linalg.det(Vt) > 0.0 else -1.0
    for i in range(3):
        for j in range(3):
            R[i, j] = U[i, 0] * Vt[0, j] + U[i, 1] * Vt[1, j] + sign * U[i, 2] * Vt[2, j]
    return R


@compiled
def aligned(H, mu_s, mu_t):  # type: ignore[no-untyped-def]
    """`from_moments`, for kernels."""
    R, T = _nearest_rotation(H), np.zeros((4, 4))
    T[3, 3] = 1.0
    for i in range(3):
        T[i, 3] = mu_t[i]
        for j in range(3):
            T[i, j] = R[j, i]
            T[i, 3] -= R[j, i] * mu_s[j]
    return T


@compiled
def inverse_of(T):  # type: ignore[no-untyped-def]
    """`inverse`, for kernels."""
    out = np.zeros((4, 4))
    out[3, 3] = 1.0
    for i in range(3):
        for j in range(3):
            out[i, j] = T[j, i]
            out[i, 3] -= T[j, i] * T[j, 3]
    return out


@compiled
def _exp(xi):  # type: ignore[no-untyped-def]
    """`exp` of a contiguous array."""
    T, V = np.zeros((4, 4)), np.empty((3, 3))
    T[3, 3] = 1.0
    _about(xi[3], xi[4], xi[5], 0, T)
    _about(xi[3], xi[4], xi[5], 1, V)
    for i in range(3):
        T[i, 3] = V[i, 0] * xi[0] + V[i, 1] * xi[1] + V[i, 2] * xi[2]
    return T


@compiled
def _log(T):  # type: ignore[no-untyped-def]
    """`log` of a contiguous array."""
    w, V = turn_of(T), np.empty((3, 3))
    angle = np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    k = 1.0 / 12.0
    if angle >= 1e-4:
        k = 1.0 / angle**2
        if np.pi - angle >= 1e-6:
            k -= (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
    _quadratic(w[0], w[1], w[2], -0.5, k, V)  # inverse of the left Jacobian
    xi = np.empty(6)
    for i in range(3):
        xi[i] = V[i, 0] * T[0, 3] + V[i, 1] * T[1, 3] + V[i, 2] * T[2, 3]
        xi[3 + i] = w[i]
    return xi

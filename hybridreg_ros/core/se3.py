# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms as 4x4 float64 arrays: exp, log, inverse, interpolation, Kabsch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

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
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inverse(T: F64) -> F64:
    """Inverse of a rigid transform (4, 4); exact up to rounding, no general matrix inverse."""
    R, t = T[:3, :3], T[:3, 3]
    return transform(R.T, -R.T @ t)


def apply(T_target_source: F64, points: NDArray[Real]) -> NDArray[Real]:
    """Move points from the source to the target frame.

    Args:
        T_target_source: (4, 4).
        points: (N, 3), metres, source frame.

    Returns:
        (N, 3) of the dtype of `points`, target frame.
    """
    R = T_target_source[:3, :3].astype(points.dtype)
    t = T_target_source[:3, 3].astype(points.dtype)
    moved: NDArray[Real] = points @ R.T + t
    return moved


def hat(w: F64) -> F64:
    """Skew matrix of w (3,), so that its product with v is the cross product w x v."""
    x, y, z = w
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def so3_exp(w: F64) -> F64:
    """Rotation (3, 3) of a rotation vector w (3,), radians (Rodrigues' formula)."""
    angle = float(np.linalg.norm(w))
    W = hat(np.asarray(w, dtype=np.float64))
    if angle < _SMALL_ANGLE_RAD:
        R: F64 = np.eye(3) + W + 0.5 * W @ W
        return R
    a = np.sin(angle) / angle
    b = (1.0 - np.cos(angle)) / angle**2
    R = np.eye(3) + a * W + b * W @ W
    return R


def so3_log(R: F64) -> F64:
    """Rotation vector (3,), radians, of a rotation (3, 3); its norm lies in [0, pi]."""
    axis2sin = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sin2 = float(np.linalg.norm(axis2sin))
    angle = float(np.arctan2(0.5 * sin2, 0.5 * (np.trace(R) - 1.0)))
    if angle < _SMALL_ANGLE_RAD:
        w: F64 = 0.5 * axis2sin
        return w
    if np.pi - angle < 1e-4:
        # Near pi the antisymmetric part vanishes: the symmetric one gives the axis a,
        # (R + R^T) / 2 = cos(angle) I + (1 - cos(angle)) a a^T.
        S = (0.5 * (R + R.T) - np.cos(angle) * np.eye(3)) / (1.0 - np.cos(angle))
        k = int(np.argmax(np.diag(S)))
        axis = S[:, k] / np.sqrt(max(S[k, k], 1e-12))
        axis = axis / np.linalg.norm(axis)
        if float(axis @ axis2sin) < 0.0:
            axis = -axis
        w = angle * axis
        return w
    w = angle / sin2 * axis2sin
    return w


def exp(xi: F64) -> F64:
    """Transform (4, 4) of a twist (6,): translation part (metres) first, then rotation (rad)."""
    rho, w = np.asarray(xi[:3], dtype=np.float64), np.asarray(xi[3:], dtype=np.float64)
    angle = float(np.linalg.norm(w))
    W = hat(w)
    if angle < _SMALL_ANGLE_RAD:
        V = np.eye(3) + 0.5 * W + W @ W / 6.0
    else:
        V = (
            np.eye(3)
            + (1.0 - np.cos(angle)) / angle**2 * W
            + (angle - np.sin(angle)) / angle**3 * W @ W
        )
    return transform(so3_exp(w), V @ rho)


def log(T: F64) -> F64:
    """Twist (6,) of a transform: translation part (metres) first, then rotation (rad)."""
    w = so3_log(T[:3, :3])
    angle = float(np.linalg.norm(w))
    W = hat(w)
    if angle < 1e-4:
        V_inv = np.eye(3) - 0.5 * W + W @ W / 12.0
    else:
        k = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
        if np.pi - angle < 1e-6:
            k = 1.0 / angle**2
        V_inv = np.eye(3) - 0.5 * W + k * W @ W
    return np.concatenate([V_inv @ T[:3, 3], w])


def interpolate(T_a: F64, T_b: F64, s: float) -> F64:
    """Transform at share s of the screw motion from T_a (s = 0) to T_b (s = 1)."""
    result: F64 = T_a @ exp(s * log(inverse(T_a) @ T_b))
    return result


def rotation_angle_deg(R: F64) -> float:
    """Angle of a rotation (3, 3) in degrees, in [0, 180]."""
    return float(np.rad2deg(np.linalg.norm(so3_log(R))))


def orthonormalise(T: F64) -> F64:
    """Nearest rigid transform: the rotation part is projected onto SO(3) by SVD."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    D = np.diag([1.0, 1.0, np.linalg.det(U @ Vt)])
    return transform(U @ D @ Vt, T[:3, 3])


def is_rigid(T: NDArray[np.floating], tolerance: float = 1e-4) -> bool:
    """True when T is (4, 4), finite, and its rotation part is a proper rotation."""
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return False
    R = T[:3, :3]
    return bool(
        np.allclose(R @ R.T, np.eye(3), atol=tolerance)
        and np.linalg.det(R) > 0.0
        and np.allclose(T[3], [0.0, 0.0, 0.0, 1.0], atol=tolerance)
    )


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
    U, _, Vt = np.linalg.svd(H)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T)) or 1.0])
    R = Vt.T @ D @ U.T
    return transform(R, mu_t - R @ mu_s)

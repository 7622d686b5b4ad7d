# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Depth images: 16-bit PNG to metres, metres to points in the optical frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import FileFormatError, require

if TYPE_CHECKING:
    from numpy.typing import NDArray

_INVALID = (0, 65535)


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera without distortion, pixels."""

    fx: float
    fy: float
    cx: float
    cy: float


def read_intrinsics(path: str | Path) -> Intrinsics:
    """Intrinsics of a text file with a 3x3 matrix, or with fx fy cx cy.

    Raises:
        FileFormatError: the file is missing or holds neither, or a focal length is not positive.
    """
    try:
        values = [float(v) for v in Path(path).read_text('utf-8').replace(',', ' ').split()]
    except OSError as error:
        raise FileFormatError(f'cannot read intrinsics {path}: {error.strerror}') from None
    except ValueError as error:
        raise FileFormatError(f'{path}: expected numbers only, {error}') from None
    if len(values) not in (4, 9):
        raise FileFormatError(f'{path}: expected 9 or 4 numbers, found {len(values)}')
    if len(values) == 9:
        values = [values[0], values[4], values[2], values[5]]
    if not np.isfinite(values).all() or min(values[:2]) <= 0.0:
        raise FileFormatError(f'{path}: expected focal lengths above 0, found {values}')
    return Intrinsics(*values)


def read_depth_m(path: str | Path, units_per_m: float = 1000.0) -> NDArray[np.float32]:
    """Depth (H, W) float32 along the optical axis, metres; NaN where there is no return.

    Args:
        path: 16-bit single-channel PNG; 0 and 65535 mean no return.
        units_per_m: raw units per metre (1000 for millimetres, 5000 for TUM).

    Raises:
        FileFormatError: the file is missing, damaged, or another kind of image.
        DependencyError: pillow is not installed.
    """
    require('a depth image', 'data', 'PIL')
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            raw = np.array(image)
    except UnidentifiedImageError:
        raise FileFormatError(f'{path} is not an image') from None
    except (OSError, SyntaxError, ValueError) as error:
        raise FileFormatError(f'cannot read {path}: {error}') from None
    if raw.ndim != 2 or raw.dtype.kind not in 'ui' or raw.dtype.itemsize < 2:
        raise FileFormatError(
            f'{path}: expected 16-bit depth, found {raw.dtype} of shape {raw.shape}'
        )
    depth = raw.astype(np.float32) / np.float32(units_per_m)
    depth[np.isin(raw, _INVALID)] = np.nan
    return depth


def organised_points(
    depth_m: NDArray[np.float32],
    camera: Intrinsics,
    max_depth_m: float = np.inf,
    pixel_step: int = 1,
) -> NDArray[np.float32]:
    """Points (H, W, 3) of a depth image: optical frame (x right, y down, z ahead); NaN = none.

    Args:
        depth_m: depth along the optical axis, metres; NaN, inf and values <= 0 are no return.
        camera: intrinsics of this resolution.
        max_depth_m: farther pixels are no return.
        pixel_step: take every n-th row and column.
    """
    z = depth_m[::pixel_step, ::pixel_step]
    z = np.where((z > 0.0) & (z <= max_depth_m) & np.isfinite(z), z, np.float32(np.nan))
    rows, columns = (pixel_step * np.arange(n) for n in z.shape)
    x = (columns[None, :] - camera.cx) / camera.fx * z
    y = (rows[:, None] - camera.cy) / camera.fy * z
    return np.stack([x, y, z], axis=-1).astype(np.float32)


def depth_to_points(
    depth_m: NDArray[np.float32], camera: Intrinsics, max_depth_m: float = np.inf
) -> NDArray[np.float32]:
    """Points (N, 3) of the pixels of a depth image that have a return, row by row.

    Args:
        depth_m: as `organised_points`.
        camera: intrinsics of this resolution.
        max_depth_m: farther pixels are skipped.
    """
    points = organised_points(depth_m, camera, max_depth_m)
    return points[np.isfinite(points[..., 2])]

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""16-bit depth images to organised clouds in the optical frame of a pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import DependencyError, FileFormatError
from hybridreg_ros.core.pointcloud2 import CloudData, from_arrays

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

INVALID = (0, 65535)


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of a camera without distortion, pixels.

    Attributes:
        fx: focal length along x.
        fy: focal length along y.
        cx: principal point, x.
        cy: principal point, y.
    """

    fx: float
    fy: float
    cx: float
    cy: float


def read_intrinsics(path: Path) -> Pinhole:
    """Intrinsics from a text file with a 3x3 matrix, or with fx fy cx cy.

    Raises:
        FileFormatError: missing, or neither of both.
    """
    try:
        values = [float(v) for v in path.read_text('utf-8').replace(',', ' ').split()]
    except OSError as error:
        raise FileFormatError(f'cannot read intrinsics {path}: {error.strerror}') from None
    except ValueError:
        raise FileFormatError(
            f'{path}: expected numbers only (3x3 matrix or fx fy cx cy)'
        ) from None
    if len(values) >= 9:
        return Pinhole(values[0], values[4], values[2], values[5])
    if len(values) == 4:
        return Pinhole(*values)
    raise FileFormatError(f'{path}: expected 9 or 4 numbers, found {len(values)}')


def read_depth(path: Path) -> NDArray[np.uint16]:
    """Raw values (H, W) of a 16-bit single-channel PNG.

    Raises:
        FileFormatError: missing, damaged, or another kind of image.
        DependencyError: pillow is not installed.
    """
    try:
        from PIL import Image, UnidentifiedImageError
    except ImportError:
        raise DependencyError(
            "depth images need pillow: pip install 'hybridreg_ros[replay]'"
        ) from None
    try:
        with Image.open(path) as image:
            values = np.array(image)
    except UnidentifiedImageError:
        raise FileFormatError(f'{path} is not an image') from None
    except (OSError, SyntaxError, ValueError) as error:
        raise FileFormatError(f'cannot read {path}: {error}') from None
    if values.ndim != 2 or values.dtype.kind not in 'ui' or values.dtype.itemsize < 2:
        raise FileFormatError(
            f'{path}: expected 16-bit depth, found {values.dtype} of shape {values.shape}'
        )
    return values.astype(np.uint16)


def back_project(
    raw: NDArray[np.uint16],
    camera: Pinhole,
    units_per_m: float,
    max_depth_m: float,
    pixel_step: int = 1,
) -> CloudData:
    """Organised cloud of a depth image, NaN where there is no return.

    Args:
        raw: (H, W) depth along the optical axis; 0 and 65535 are missing.
        camera: intrinsics of the full image.
        units_per_m: raw units per metre (1000 for millimetres, 5000 for TUM).
        max_depth_m: farther pixels are missing, metres.
        pixel_step: take every n-th row and column.
    """
    v, u = np.meshgrid(
        np.arange(0, raw.shape[0], pixel_step),
        np.arange(0, raw.shape[1], pixel_step),
        indexing='ij',
    )
    values = raw[::pixel_step, ::pixel_step]
    z = values.astype(np.float32) / np.float32(units_per_m)
    z[np.isin(values, INVALID) | (z > max_depth_m)] = np.nan
    points = np.stack(
        [(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=-1
    )
    return from_arrays(points.reshape(-1, 3).astype(np.float32), shape=z.shape)

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Arrays that do not say how they are laid out: headerless .bin files, and (3, N) for (N, 3).

Values of one column are more like each other than like those of another column. So the mean
difference between values k apart is smallest where k is the number of columns: by the inequality
of energy distances whatever the order of the points, and all the more for neighbours in a scan.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import FileFormatError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

USUAL_COLUMNS = 4
"""x y z intensity, as KITTI has them."""
LAYOUTS = range(3, 9)
_MOST_COLUMNS = 64
_FEW = 16
_SAMPLE = 120_000
_CERTAIN = 4.0
"""So many standard errors must lie between the differences of two layouts."""
_CLEARLY = 0.02
"""And so much of them."""
_FARTHEST = 1e6
_NEAREST = 1e-12
_ABSURD_SHARE = 0.02


def read_bin(path: Path, columns: int | None = None) -> NDArray[np.float32]:
    """Rows (N, K) of a headerless file of little-endian float32.

    Args:
        path: file.
        columns: K; None tells it by the values.

    Raises:
        FileFormatError: missing, the size fits no layout, the values do not tell it, or are no
            coordinates.
    """
    try:
        with np.errstate(over='ignore', invalid='ignore'):
            return _rows(path.read_bytes(), columns)
    except OSError as error:
        raise FileFormatError(f'cannot read cloud {path}: {error.strerror or error}') from None
    except ValueError as error:
        raise FileFormatError(f'{path} is not a readable .bin cloud: {error}') from None


def _rows(data: bytes, columns: int | None) -> NDArray[np.float32]:
    if len(data) % 4 or not data:
        raise ValueError(f'{len(data)} bytes are no rows of float32: cut off, or another type')
    values = np.frombuffer(data, '<f4')
    count = columns if columns is not None else columns_of(values)
    if len(values) % count:
        raise ValueError(
            f'{len(data)} bytes are not a multiple of {4 * count} ({count} columns): cut off, or '
            'other columns (--columns)'
        )
    rows = values.reshape(-1, count)
    _check_coordinates(rows[:, :3])
    return rows


def columns_of(values: NDArray[np.float32]) -> int:
    """Number of columns 3 to 8 of a flat array (M,) of points, told by its values.

    Where they do not tell, four (KITTI) if that divides M.

    Raises:
        ValueError: the values do not tell, are those of fewer columns, or M is no multiple.
    """
    mean, error = _differences(values, (1, 2, *LAYOUTS))

    def clearly(a: int, b: int) -> bool:
        """Whether the values speak for a instead of b."""
        needed = max(_CERTAIN * float(np.hypot(error[a], error[b])), _CLEARLY * mean[b])
        return mean[b] - mean[a] > needed

    best = min(LAYOUTS, key=lambda k: mean[k])
    equal = [k for k in LAYOUTS if not clearly(best, k)]
    size = 4 * len(values)
    if clearly(1, best) or clearly(2, best):
        raise ValueError('its values follow each other as if they were no points (x y z ...)')
    count = USUAL_COLUMNS if USUAL_COLUMNS in equal else equal[0]
    if count != USUAL_COLUMNS and any(k % count for k in equal):
        said = ', '.join(str(k) for k in equal)
        raise ValueError(f'its values do not tell how many columns it has ({said}): say --columns')
    if len(values) % count:
        raise ValueError(
            f'{size} bytes are not a multiple of {4 * count} (float32 in {count} columns, as its '
            'values look): cut off, or other columns (--columns)'
        )
    return count


def _differences(
    values: NDArray[np.float32], lags: tuple[int, ...]
) -> tuple[dict[int, float], dict[int, float]]:
    """Mean difference between values so far apart, far ones tamed, and its standard error."""
    sample = values[:_SAMPLE].astype(np.float64)
    even = np.sign(sample) * np.log1p(np.abs(sample))
    steps = {k: np.abs(even[k:] - even[:-k]) for k in lags}
    steps = {k: s[np.isfinite(s)] for k, s in steps.items()}
    mean = {k: float(s.mean()) if len(s) else 0.0 for k, s in steps.items()}
    return mean, {
        k: float(s.std()) / max(len(s), 1) ** 0.5 if len(s) else 0.0 for k, s in steps.items()
    }


def _check_coordinates(xyz: NDArray[np.float32]) -> None:
    """Refuse values that no sensor gives.

    Raises:
        ValueError: more than a few are too large, or so small that they must be something else.
    """
    if not len(xyz):
        return
    size = np.abs(xyz)
    absurd = (size > _FARTHEST) | ((size > 0.0) & (size < _NEAREST))
    if absurd.mean() > _ABSURD_SHARE:
        raise ValueError(
            f'{100 * absurd.mean():.0f} % of the values are no coordinates in metres: expected '
            'rows of float32 x y z ... (another type, another order, or a header?)'
        )


def points_in_rows(array: NDArray[Any]) -> NDArray[Any]:
    """The array (N, K >= 3) itself, or turned over where its points are columns: (3 or 4, N).

    Raises:
        ValueError: more columns than a point can have.
    """
    if array.ndim != 2:
        return array
    rows, columns = array.shape
    if columns <= _FEW or (rows > _FEW and columns <= _MOST_COLUMNS):
        return array
    if rows in (3, 4):
        return array.T
    raise ValueError(f'shape {array.shape}: expected (N, 3), one point a row, or (3, N)')

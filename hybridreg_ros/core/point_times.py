# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Per-point times of any driver to seconds relative to the scan's stamp."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import PointCloudError
from hybridreg_ros.core.scan import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

UNITS = {'ns': 1e-9, 'us': 1e-6, 'ms': 1e-3, 's': 1.0}
MIN_SPAN_S = 2e-3
MAX_SPAN_S = 5.0
MAX_OFFSET_S = 10.0
_NORMALISED_SPAN = 0.6
"""No spinning lidar takes this many seconds per turn: a longer span inside [0, 1] is a share."""


def to_seconds(
    raw: NDArray[Any], stamp_ns: int, unit: str = 'auto', scan_period_s: float = 0.1
) -> tuple[NDArray[np.float64] | None, str]:
    """Convert per-point times to seconds relative to the stamp of their message.

    Absolute times (since an epoch) become relative to the stamp; when the sensor's clock is more
    than 10 s away from the stamp, relative to the earliest point.

    Args:
        raw: (N,) values of the time field, any number type, N >= 1.
        stamp_ns: stamp of the message, ns.
        unit: s, ms, us, ns, normalised (share of the scan period), or auto: the unit in which the
            times of the scan span 2 ms to 5 s; floats in [0, 1] spanning more than 0.6 count as
            normalised.
        scan_period_s: duration that a normalised 1 stands for.

    Returns:
        (N,) float64 seconds and an empty note; or None and a note saying why they are unusable
        (NaN, all equal, no unit fits).

    Raises:
        PointCloudError: unknown unit.
    """
    if unit not in (*UNITS, 'auto', 'normalised'):
        raise PointCloudError(
            f'time unit {unit!r}: expected auto, normalised, {", ".join(UNITS)} or none'
        )
    if not np.isfinite(raw).all():
        return None, f'{int((~np.isfinite(raw)).sum())} per-point times are NaN or inf; not used'
    low, high = raw.min(), raw.max()
    if low == high:
        return None, 'all per-point times are equal; not used'
    # Subtract in the field's own type: uint64 epoch nanoseconds do not fit a float64.
    since_first = (raw - low).astype(np.float64)
    span = float(since_first.max())
    chosen = _unit(span, float(low), float(high), raw.dtype) if unit == 'auto' else unit
    if chosen is None:
        return None, f'span {span:g} fits no time unit; not used'
    scale = scan_period_s if chosen == 'normalised' else UNITS[chosen]
    if span * scale > MAX_SPAN_S:
        return None, f'span of {span * scale:g} s exceeds {MAX_SPAN_S:g} s; not used'
    offset_s = _offset_s(low, scale, stamp_ns)
    return since_first * scale + offset_s, ''


def _unit(span: float, low: float, high: float, dtype: np.dtype[Any]) -> str | None:
    """Unit in which the span is that of a scan."""
    if dtype.kind == 'f' and low >= 0.0 and high <= 1.0 and span > _NORMALISED_SPAN:
        return 'normalised'
    for unit, scale in UNITS.items():
        if MIN_SPAN_S <= span * scale <= MAX_SPAN_S:
            return unit
    return None


def _offset_s(low: Any, scale: float, stamp_ns: int) -> float:
    """Time of the earliest point relative to the stamp, seconds."""
    first_s = float(low) * scale
    if abs(first_s) <= MAX_OFFSET_S:
        return first_s
    if np.asarray(low).dtype.kind in 'iu':
        first_ns = int(low) * round(scale * NS_PER_S)
        relative_s = (first_ns - stamp_ns) / NS_PER_S
    else:
        relative_s = float(low * scale - stamp_ns / NS_PER_S)
    return relative_s if abs(relative_s) <= MAX_OFFSET_S else 0.0

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Per-point times of any driver to seconds relative to the scan's stamp."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hybridreg_ros.core.errors import PointCloudError
from hybridreg_ros.core.scan import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

UNITS = {'ns': 1e-9, 'us': 1e-6, 'ms': 1e-3, 's': 1.0}
AUTO = 'auto'
TIME_FIELDS = {
    't': AUTO,  # Ouster (ns), SICK (us)
    'time': AUTO,  # Velodyne (s)
    'timestamp': AUTO,  # Hesai, RoboSense (s since an epoch), Livox (ns since an epoch)
    'offset_time': AUTO,  # Livox (ns)
    'time_stamp': AUTO,
    'times': AUTO,
    'timestamps': AUTO,
    'stamp': AUTO,
    'stamps': AUTO,
    'time_offset': AUTO,
    'timeoffset': AUTO,
    'point_time_offset': AUTO,  # Blickfeld (ns)
    'relative_time': AUTO,
    'offset_ns': 'ns',  # Argoverse 2
    'time_us': 'us',
    'ts': AUTO,  # SICK (s)
    'lidar_nsec': 'ns',  # SICK, with lidar_sec
    'nsec': 'ns',
    'curvature': 'ms',  # clouds made for FAST-LIO; a true curvature does not span milliseconds
}
"""Names, in small letters, under which drivers store per-point times, and their unit."""

SECONDS_OF = {'lidar_nsec': 'lidar_sec', 'nsec': 'sec'}
"""Field of whole seconds that goes with a field of nanoseconds."""

MIN_SPAN_S = 2e-3
MAX_SPAN_S = 1.0
MAX_OFFSET_S = 1.0
_NORMALISED_SPAN = 0.6
"""No spinning lidar takes this many seconds per turn: a longer span inside [0, 1] is a share."""
_TAIL = 0.1
"""Share of the points at either end that says nothing about the span of a scan."""
_REACH = 5.0
"""Times farther from the rest than so many spans of the rest belong to another scan."""
_SAMPLE = 4000


class PointTimes(NamedTuple):
    """Per-point times of one scan.

    Attributes:
        seconds: (N,) float64 seconds relative to the stamp, None when they are unusable.
        keep: (N,) bool, False where a point's own time is none (NaN, or far from all others).
        unit: what they were read as: s, ms, us, ns or normalised.
        note: what could not be used and why, '' when all is well.
    """

    seconds: NDArray[np.float64] | None
    keep: NDArray[np.bool_]
    unit: str = ''
    note: str = ''


def time_fields(names: Iterable[str]) -> list[str]:
    """Those of a cloud's fields that are known to hold per-point times, the likeliest first."""
    ranks = {name: rank for rank, name in enumerate(TIME_FIELDS)}
    return sorted((n for n in names if n.lower() in ranks), key=lambda n: ranks[n.lower()])


def to_seconds(
    raw: NDArray[Any],
    stamp_ns: int,
    unit: str = AUTO,
    scan_period_s: float = 0.1,
    field: str = '',
) -> PointTimes:
    """Convert per-point times to seconds relative to the stamp of their message.

    Times of which up to a tenth at either end is NaN or far from all others are those of the
    others. Absolute times (since an epoch) become relative to the stamp; when the sensor's clock
    is more than 1 s away from the stamp, relative to the earliest point.

    Args:
        raw: (N,) values of the time field, any number type, N >= 1.
        stamp_ns: stamp of the message, ns.
        unit: s, ms, us, ns, normalised (share of the scan period), or auto: the unit in which the
            times of the scan span 2 ms to 1 s; floats in [0, 1] spanning more than 0.6 count as
            normalised.
        scan_period_s: duration that a normalised 1 stands for.
        field: name of the field; with auto, `TIME_FIELDS` may know that only one unit fits.

    Returns:
        The times, or a note why they are unusable (NaN, all equal, no unit fits).

    Raises:
        PointCloudError: unknown unit.
    """
    if unit not in (*UNITS, AUTO, 'normalised'):
        raise PointCloudError(
            f'time unit {unit!r}: expected auto, normalised, {", ".join(UNITS)} or none'
        )
    # Whole numbers stay so: epoch nanoseconds do not fit a float64.
    with np.errstate(invalid='ignore'):  # signalling NaN are NaN too
        values = raw.astype(np.int64 if raw.dtype.kind in 'iub' else np.float64)
    finite = np.isfinite(values)
    unusable = len(raw) - int(np.count_nonzero(finite))
    if unusable > _TAIL * len(raw):
        return _none(raw, f'{unusable} of {len(raw)} per-point times are NaN or inf; not used')
    low, high = _core(values[finite])
    core = float(high - low)
    if core == 0.0:
        return _none(raw, 'all per-point times are equal; not used')
    is_float = raw.dtype.kind == 'f'
    usual = TIME_FIELDS.get(field.lower(), AUTO)
    chosen = _unit((low, high), usual, is_float) if unit == AUTO else unit
    if chosen is None:
        return _none(raw, f'span {core / (1 - 2 * _TAIL):g} fits no time unit; not used')
    scale = scan_period_s if chosen == 'normalised' else UNITS[chosen]
    if core * scale > MAX_SPAN_S:
        return _none(raw, f'span of {core * scale:g} s exceeds {MAX_SPAN_S:g} s; not used')
    first, last = _limits(values[finite], low, high, MAX_SPAN_S / scale)
    keep = finite & (values >= first) & (values <= last)
    first = values[keep].min().item()
    since_first = (np.where(keep, values, first) - first).astype(np.float64)
    left_out = len(raw) - int(np.count_nonzero(keep))
    note = f'{left_out} points left out whose times are not those of the scan' if left_out else ''
    return PointTimes(since_first * scale + _offset_s(first, scale, stamp_ns), keep, chosen, note)


def _none(raw: NDArray[Any], why: str) -> PointTimes:
    return PointTimes(None, np.ones(len(raw), np.bool_), '', why)


def _core(values: NDArray[Any]) -> tuple[Any, Any]:
    """Between which values all but the outermost tenths lie."""
    some = np.sort(values[:: max(1, len(values) // _SAMPLE)])
    cut = int(_TAIL * (len(some) - 1))
    return some[cut].item(), some[len(some) - 1 - cut].item()


def _limits(values: NDArray[Any], low: Any, high: Any, longest: float) -> tuple[Any, Any]:
    """First and last time that can belong to the scan whose core is low to high."""
    core, kind = high - low, type(low)
    reach = kind(min(_REACH * core, longest))
    first, last = max(values.min().item(), low - reach), min(values.max().item(), high + reach)
    if last - first > longest:
        reach = kind((longest - core) / 2)
        first, last = max(first, low - reach), min(last, high + reach)
    return first, last


def _unit(ends: tuple[float, float], usual: str, is_float: bool) -> str | None:
    """Unit in which a core of these ends is that of a scan; only the usual one, where known."""
    (low, high), core = ends, float(ends[1] - ends[0])
    span = core / (1 - 2 * _TAIL)
    if usual == AUTO and is_float and low >= 0.0 and high <= 1.0 and span > _NORMALISED_SPAN:
        return 'normalised'
    for unit, scale in UNITS.items():
        if usual in (AUTO, unit) and span * scale >= MIN_SPAN_S and core * scale <= MAX_SPAN_S:
            return unit
    return None


def _offset_s(first: Any, scale: float, stamp_ns: int) -> float:
    """Time of the earliest point relative to the stamp, seconds."""
    first_s = float(first) * scale
    if abs(first_s) <= MAX_OFFSET_S:
        return first_s
    if isinstance(first, int):
        relative_s = (first * round(scale * NS_PER_S) - stamp_ns) / NS_PER_S
    else:
        relative_s = float(first * scale - stamp_ns / NS_PER_S)
    return relative_s if abs(relative_s) <= MAX_OFFSET_S else 0.0

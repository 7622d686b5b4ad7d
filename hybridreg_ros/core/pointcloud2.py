# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/PointCloud2, duck-typed, to Scan and back; numpy only, no ROS import.

One decoder serves the live node (rclpy messages) and the bag reader (rosbags messages).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hybridreg_ros.core.errors import PointCloudError
from hybridreg_ros.core.point_times import AUTO, SECONDS_OF, time_fields, to_seconds
from hybridreg_ros.core.scan import NO_RETURN_M, NS_PER_S, Scan, taken, units_note

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

MOST_POINTS = 400_000
"""Points of a cloud that an odometry has use for: more than a depth camera of 640 x 480 has."""

_FORMATS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
_MAX_STEP = 1 << 16
"""Bytes that a point may have; with more, a layout is broken and numpy's types may not hold it."""
_CODES = {np.dtype(name): code for code, name in _FORMATS.items()}


class Field(NamedTuple):
    """One sensor_msgs/PointField: name, byte offset in the point, datatype code 1..8, count."""

    name: str
    offset: int
    datatype: int
    count: int  # type: ignore[assignment]  # a tuple's own count() is not used here


@dataclass(frozen=True, eq=False)
class CloudData:
    """The attributes of a sensor_msgs/PointCloud2 without its header.

    Attributes:
        height: rows of an organised cloud, 1 otherwise.
        width: points per row.
        fields: layout of one point.
        is_bigendian: byte order of `data`.
        point_step: bytes per point.
        row_step: bytes per row.
        data: (height * row_step,) uint8.
        is_dense: True when no point holds NaN or inf.
    """

    height: int
    width: int
    fields: tuple[Field, ...]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: NDArray[np.uint8]
    is_dense: bool


def to_scan(
    msg: Any,
    time_unit: str = AUTO,
    scan_period_s: float = 0.1,
    time_field: str = '',
    max_points: int | None = None,
) -> Scan:
    """Decode a PointCloud2 message: any field layout, offset, padding and byte order.

    Args:
        msg: object with the attributes of sensor_msgs/PointCloud2 (rclpy, rosbags or alike).
        time_unit: unit of the per-point times: auto, s, ms, us, ns, normalised or none.
        scan_period_s: seconds that a normalised time of 1 stands for.
        time_field: field with the per-point times; '' = the first usable one of those in
            `point_times.TIME_FIELDS`.
        max_points: of a cloud with more, every second, third, ... row is taken; None = all.

    Returns:
        The scan; rows with a NaN or inf coordinate, at the sensor (no return: `Scan.near`), or
        with a time that is far from all others are left out of every field. `Scan.times_from`
        says what the times were made from, `Scan.notes` what could not be used, or seems not to be
        in metres. An empty cloud gives N = 0.

    Raises:
        PointCloudError: the layout contradicts itself, data are missing, or x, y, z (or X, Y, Z)
            are absent.
    """
    rows_data = _rows(msg)
    layout = _dtype(msg)
    axes, missing = coordinates(layout.names or ())
    if missing:
        found = ', '.join(layout.names or ()) or 'none'
        raise PointCloudError(f'PointCloud2 lacks field {", ".join(missing)}; found: {found}')
    whole = rows_data.view(layout).reshape(-1)
    every = max(1, -(-len(whole) // max_points)) if max_points else 1
    table = whole[::every]
    xyz = np.empty((len(table), 3), dtype=np.float32)
    with np.errstate(over='ignore', invalid='ignore'):
        for column, axis in enumerate(axes):
            xyz[:, column] = _column(table, axis)
        squared = np.einsum('ij,ij->i', xyz, xyz)
    finite = np.isfinite(squared)
    seen = finite & (squared >= NO_RETURN_M**2)
    rows = np.flatnonzero(seen)
    stamp = int(msg.header.stamp.sec) * NS_PER_S + int(msg.header.stamp.nanosec)
    found_times = _Times(None, rows, 'none: the cloud is empty', ())
    if time_unit == 'none':
        found_times = found_times._replace(used='none: time_unit is none')
    elif len(rows):
        found_times = _times(table, rows, stamp, (time_unit, scan_period_s, time_field))
    rows = found_times.rows
    points = xyz if len(rows) == len(xyz) else taken(xyz, rows)
    unit_note = units_note(points)
    return Scan(
        points=points,
        times=found_times.seconds,
        stamp=stamp,
        frame_id=str(msg.header.frame_id),
        rows=rows * every,
        size=len(whole),
        thinned=len(whole) - len(table),
        shape=(int(msg.height), int(msg.width)),
        near=int(np.count_nonzero(finite)) - int(np.count_nonzero(seen)),
        notes=(*found_times.notes, unit_note) if unit_note else found_times.notes,
        times_from=found_times.used,
    )


class _Times(NamedTuple):
    """Times of the rows that are kept, what they were made from, and what was not usable."""

    seconds: NDArray[np.float64] | None
    rows: NDArray[np.int64]
    used: str
    notes: tuple[str, ...]


def _times(
    table: NDArray[Any], rows: NDArray[np.int64], stamp: int, wanted: tuple[str, float, str]
) -> _Times:
    """Per-point times of some rows: of the field asked for, or of the first usable one.

    Args:
        table: (M,) structured, all points.
        rows: (N,) those with coordinates, N >= 1.
        stamp: of the message, ns.
        wanted: unit, scan period (s) and name of the field, '' for any.
    """
    unit, period_s, field = wanted
    names = table.dtype.names or ()
    listing = ', '.join(names)
    if field and field not in names:
        return _Times(None, rows, f'none: no field {field}', (f'no field {field} in: {listing}',))
    notes = []
    for name in (field,) if field else time_fields(names):
        times = to_seconds(_raw_times(table, rows, name), stamp, unit, period_s, name)
        if times.note:
            notes.append(f'field {name}: {times.note}')
        if times.seconds is not None:
            kept = slice(None) if times.keep.all() else times.keep
            about = (notes[-1],) if times.note else ()
            return _Times(times.seconds[kept], rows[kept], f'{name} ({times.unit})', about)
    if notes:
        return _Times(None, rows, 'none: no time field is usable', tuple(notes))
    return _Times(None, rows, f'none: no known time field in {listing}', ())


def _raw_times(table: NDArray[Any], rows: NDArray[np.int64], name: str) -> NDArray[Any]:
    """Values of a time field, (N,); where whole seconds stand apart, joined with them."""
    raw = _column(table, name)[rows]
    partner = SECONDS_OF.get(name.lower())
    names = {n.lower(): n for n in table.dtype.names or ()}
    if partner is None or raw.dtype.kind not in 'iu':
        return raw
    raw = raw.astype(np.int64)
    if partner in names:
        raw += _column(table, names[partner])[rows].astype(np.int64) * NS_PER_S
    elif np.ptp(raw) > NS_PER_S // 2:  # a second ended during the scan
        raw[raw < NS_PER_S // 2] += NS_PER_S
    return raw


def _column(table: NDArray[Any], name: str) -> NDArray[Any]:
    """Values of a field, the first of several per point."""
    values = table[name]
    return values if values.ndim == 1 else values[:, 0]


def coordinates(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names of the fields x, y and z, in small or else capital letters, and which are missing.

    >>> coordinates(['X', 'Y', 'intensity'])
    (['X', 'Y'], ['z'])
    """
    found, missing = [], []
    for axis in 'xyz':
        name = next((n for n in (axis, axis.upper()) if n in names), None)
        if name is None:
            missing.append(axis)
        else:
            found.append(name)
    return found, missing


def unique_names(names: Sequence[str]) -> list[str]:
    """The names, numbered where one stands twice, so that numpy takes them.

    >>> unique_names(['x', '_', '_', ''])
    ['x', '_', '_ 2', ' 3']
    """
    seen: set[str] = set()
    found = []
    for number, name in enumerate(names):
        plain = name if name and name not in seen else f'{name} {number}'
        seen.add(plain)
        found.append(plain)
    return found


def field_values(msg: Any, name: str) -> NDArray[Any]:
    """Values of one scalar field for every row of the message, invalid rows included.

    Args:
        msg: as for `to_scan`.
        name: field name, for example 'label'.

    Returns:
        (height * width,) in the field's own type, native byte order.

    Raises:
        PointCloudError: no such field, or a broken layout.
    """
    layout = _dtype(msg)
    if name not in (layout.names or ()):
        found = ', '.join(layout.names or ()) or 'none'
        raise PointCloudError(f'PointCloud2 lacks field {name}; found: {found}')
    values = _column(_rows(msg).view(layout).reshape(-1), name)
    return np.ascontiguousarray(values.astype(values.dtype.newbyteorder('=')))


def has_field(msg: Any, name: str) -> bool:
    """True when the message has a field of that name."""
    return any(f.name == name for f in msg.fields)


def with_field(
    msg: Any, scan: Scan, name: str, values: NDArray[np.float32], keep: NDArray[np.bool_]
) -> CloudData:
    """Pick points of a message and add one float32 field; all input fields stay byte for byte.

    Args:
        msg: the message that `scan` was decoded from.
        scan: its scan, N points.
        name: field to add; an existing float32 field of this name is overwritten.
        values: (N,) one value per point of the scan.
        keep: (N,) True for points to keep.

    Returns:
        An unorganised cloud (height 1) of the kept points in the message's byte order.

    Raises:
        PointCloudError: lengths differ, or `name` exists with another type.
    """
    if len(values) != len(scan) or len(keep) != len(scan):
        raise PointCloudError(
            f'expected {len(scan)} values and flags, found {len(values)} and {len(keep)}'
        )
    fields = tuple(Field(f.name, int(f.offset), int(f.datatype), int(f.count)) for f in msg.fields)
    old = next((f for f in fields if f.name == name), None)
    if old is not None and (old.datatype != 7 or old.count > 1):
        raise PointCloudError(f'field {name} exists with datatype {old.datatype}, expected 7')
    step = int(msg.point_step)
    offset = old.offset if old is not None else -(-step // 4) * 4
    new_step = step if old is not None else offset + 4
    order = '>' if msg.is_bigendian else '<'
    # Whole points as single values: four times as fast as rows of bytes.
    points = _rows(msg).view(f'V{step}').reshape(-1).take(scan.rows[keep])
    data = np.zeros(len(points), _record(0, f'V{step}', new_step))
    data['it'] = points
    data.view(_record(offset, f'{order}f4', new_step))['it'] = values[keep]
    if old is None:
        fields = (*fields, Field(name, offset, 7, 1))
    return CloudData(
        height=1,
        width=len(data),
        fields=fields,
        is_bigendian=bool(msg.is_bigendian),
        point_step=new_step,
        row_step=new_step * len(data),
        data=data.view(np.uint8).reshape(-1),
        is_dense=True,
    )


def _record(offset: int, kind: str, itemsize: int) -> np.dtype[np.void]:
    """Records of so many bytes of which one part is of interest, called 'it'."""
    return np.dtype(
        {'names': ['it'], 'formats': [kind], 'offsets': [offset], 'itemsize': itemsize}
    )


def from_arrays(
    points: NDArray[np.floating],
    extra: Mapping[str, NDArray[Any]] | None = None,
    shape: tuple[int, int] | None = None,
) -> CloudData:
    """Encode points as little-endian PointCloud2 data.

    Args:
        points: (N, 3), metres; NaN rows mark missing returns of an organised cloud.
        extra: further per-point scalars (N,), for example {'t': seconds, 'label': uint8}.
        shape: (height, width) of an organised cloud, default (1, N).

    Raises:
        PointCloudError: an extra field has another length or an unsupported type.
    """
    n = len(points)
    height, width = shape or (1, n)
    if height * width != n:
        raise PointCloudError(f'shape {height}x{width} does not hold {n} points')
    columns: dict[str, NDArray[Any]] = {
        axis: np.asarray(points[:, k], dtype=np.float32) for k, axis in enumerate('xyz')
    }
    for name, values in (extra or {}).items():
        if np.shape(values) != (n,):
            raise PointCloudError(f'field {name} must be ({n},), found {np.shape(values)}')
        if np.dtype(values.dtype).newbyteorder('=') not in _CODES:
            raise PointCloudError(f'field {name}: PointCloud2 cannot hold {values.dtype}')
        columns[name] = values
    fields, offset = [], 0
    for name, values in columns.items():
        size = values.dtype.itemsize
        offset = -(-offset // size) * size
        code = _CODES[np.dtype(values.dtype).newbyteorder('=')]
        fields.append(Field(name, offset, code, 1))
        offset += size
    step = -(-offset // 4) * 4
    layout = np.dtype(
        {
            'names': [f.name for f in fields],
            'formats': ['<' + _FORMATS[f.datatype] for f in fields],
            'offsets': [f.offset for f in fields],
            'itemsize': step,
        }
    )
    table = np.zeros(n, dtype=layout)
    for name, values in columns.items():
        table[name] = values
    return CloudData(
        height=height,
        width=width,
        fields=tuple(fields),
        is_bigendian=False,
        point_step=step,
        row_step=step * width,
        data=table.view(np.uint8).reshape(-1),
        is_dense=bool(np.isfinite(points).all()),
    )


def _dtype(msg: Any) -> np.dtype[Any]:
    """Structured type of one point; raises when a field does not fit into point_step."""
    order = '>' if msg.is_bigendian else '<'
    names, formats, offsets = [], [], []
    step = _point_step(msg)
    for f in msg.fields:
        if f.datatype not in _FORMATS:
            raise PointCloudError(f'field {f.name}: unknown datatype {f.datatype}, expected 1..8')
        count = max(int(f.count), 1)
        end = int(f.offset) + count * np.dtype(_FORMATS[f.datatype]).itemsize
        if f.offset < 0 or end > step:
            raise PointCloudError(
                f'field {f.name} ends at byte {end} but point_step is {step}: wrong point_step'
            )
        names.append(f.name)
        formats.append(
            f'({count},){order}{_FORMATS[f.datatype]}'
            if count > 1
            else (order + _FORMATS[f.datatype])
        )
        offsets.append(int(f.offset))
    return np.dtype(
        {
            'names': unique_names(names),
            'formats': formats,
            'offsets': offsets,
            'itemsize': max(step, 1),
        }
    )


def _point_step(msg: Any) -> int:
    """Bytes of one point; raises when no sensor has as many."""
    step = int(msg.point_step)
    if step > _MAX_STEP:
        raise PointCloudError(f'point_step is {step}, expected at most {_MAX_STEP} bytes')
    return step


def _rows(msg: Any) -> NDArray[np.uint8]:
    """Bytes of every point, (height * width, point_step), row padding removed."""
    height, width = int(msg.height), int(msg.width)
    step, row_step = _point_step(msg), int(msg.row_step)
    buffer = np.frombuffer(msg.data, dtype=np.uint8)
    if height * width == 0:
        return np.zeros((0, max(step, 1)), dtype=np.uint8)
    if step <= 0:
        raise PointCloudError(f'point_step is {step}, expected the size of one point in bytes')
    if row_step < width * step:
        raise PointCloudError(
            f'row_step is {row_step}, expected >= width * point_step = {width * step}'
        )
    needed = (height - 1) * row_step + width * step
    if len(buffer) < needed:
        raise PointCloudError(
            f'truncated data: {height}x{width} points need {needed} bytes, found {len(buffer)}'
        )
    if row_step == width * step or height == 1:
        return buffer[: height * width * step].reshape(height * width, step)
    lines = [buffer[r * row_step : r * row_step + width * step] for r in range(height)]
    return np.concatenate(lines).reshape(height * width, step)

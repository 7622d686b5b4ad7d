# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Trajectory files: TUM (stamp x y z qx qy qz qw) in full precision, KITTI rows of 12 numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.core.quaternion import from_quaternion, to_quaternion
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.metrics.trajectory import Trajectory

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

KITTI_PERIOD_S = 0.1


def tum_row(stamp: int, pose: NDArray[np.float64]) -> str:
    """One line of a TUM file: nanoseconds kept exactly, the rest with 17 significant digits.

    Args:
        stamp: ns.
        pose: (4, 4) T_world_sensor, metres.
    """
    sec, nanosec = divmod(int(stamp), NS_PER_S)
    numbers = (*(float(v) for v in pose[:3, 3]), *to_quaternion(pose[:3, :3]))
    return f'{sec}.{nanosec:09d} ' + ' '.join(f'{v:.17g}' for v in numbers)


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Line number and fields of every line that is neither empty nor a comment."""
    try:
        text = path.read_text(encoding='utf-8')
    except FileNotFoundError:
        raise FileFormatError(f'no trajectory at {path}') from None
    except (UnicodeDecodeError, IsADirectoryError):
        raise FileFormatError(f'{path} is not a text file with a trajectory') from None
    lines = ((n, line.replace(',', ' ').split()) for n, line in enumerate(text.splitlines(), 1))
    return [(n, fields) for n, fields in lines if fields and not fields[0].startswith('#')]


def stamp_ns(text: str) -> int:
    """Nanoseconds of a decimal number of seconds, without going through a float."""
    sign = -1 if text.startswith('-') else 1
    whole, _, part = text.lstrip('+-').partition('.')
    if (whole + part).isdigit():
        return sign * (int(whole or 0) * NS_PER_S + int((part + '0' * 9)[:9]))
    return round(float(text) * NS_PER_S)


def read_tum(path: Path) -> Trajectory:
    """Read a TUM file.

    Raises:
        FileFormatError: missing, not text, or a line has not 8 numbers.
    """
    stamps, poses = [], []
    for number, fields in _rows(path):
        try:
            if len(fields) != 8:
                raise ValueError(f'{len(fields)} columns')
            values = [float(v) for v in fields]
            stamps.append(stamp_ns(fields[0]))
        except ValueError as error:
            raise FileFormatError(
                f'{path} line {number}: expected stamp x y z qx qy qz qw, found {error}'
            ) from None
        poses.append(se3.transform(from_quaternion(*values[4:]), np.array(values[1:4])))
    if not poses:
        raise FileFormatError(f'{path} holds no pose')
    order = np.argsort(stamps, kind='stable')
    return Trajectory(np.array(stamps, dtype=np.int64)[order], np.array(poses)[order])


def read_kitti_rows(path: Path) -> NDArray[np.float64]:
    """KITTI poses (N, 4, 4): one 3x4 matrix a line, row-major.

    Raises:
        FileFormatError: missing, empty, or a line has not 12 numbers.
    """
    poses = []
    for number, fields in _rows(path):
        try:
            values = np.array([float(v) for v in fields])
        except ValueError as error:
            raise FileFormatError(f'{path} line {number}: {error}') from None
        if len(values) != 12:
            raise FileFormatError(
                f'{path} line {number}: expected 12 numbers, found {len(values)}'
            )
        T = np.eye(4)
        T[:3] = values.reshape(3, 4)
        poses.append(se3.orthonormalise(T))
    if not poses:
        raise FileFormatError(f'{path} holds no pose')
    return np.array(poses)


def read_times(path: Path) -> list[int]:
    """Stamps in ns of a file with one number of seconds a line.

    Raises:
        FileFormatError: missing, or a line is not a number.
    """
    stamps = []
    for number, fields in _rows(path):
        try:
            stamps.append(stamp_ns(fields[0]))
        except ValueError:
            raise FileFormatError(
                f'{path} line {number}: expected seconds, found {fields[0]!r}'
            ) from None
    return stamps


def read_listing(path: Path) -> list[tuple[int, str]]:
    """Stamp (ns) and file name of every line of a TUM listing such as depth.txt.

    Raises:
        FileFormatError: missing, empty, or a line is not `stamp file`.
    """
    entries = []
    for number, fields in _rows(path):
        try:
            entries.append((stamp_ns(fields[0]), fields[1]))
        except (ValueError, IndexError):
            raise FileFormatError(f'{path} line {number}: expected stamp and file name') from None
    if not entries:
        raise FileFormatError(f'{path} lists no file')
    return sorted(entries)


def read_kitti(path: Path, times: Path | None = None) -> Trajectory:
    """Read KITTI poses and their times.

    Args:
        path: poses file.
        times: one number of seconds per line; None looks for times.txt beside it, else 10 Hz.

    Raises:
        FileFormatError: malformed, or the counts differ.
    """
    poses = read_kitti_rows(path)
    file = times if times is not None else path.with_name('times.txt')
    if times is None and not file.exists():
        stamps = [round(i * KITTI_PERIOD_S * NS_PER_S) for i in range(len(poses))]
    else:
        stamps = read_times(file)
    if len(stamps) != len(poses):
        raise FileFormatError(f'{path} has {len(poses)} poses but {file} {len(stamps)} times')
    return Trajectory(np.array(stamps, dtype=np.int64), poses)


def read_trajectory(path: Path) -> Trajectory:
    """Read a TUM or KITTI file, told apart by the number of columns.

    Raises:
        FileFormatError: neither of both.
    """
    rows = _rows(path)
    if not rows:
        raise FileFormatError(f'{path} holds no pose')
    columns = len(rows[0][1])
    if columns == 8:
        return read_tum(path)
    if columns == 12:
        return read_kitti(path)
    raise FileFormatError(
        f'{path}: expected 8 columns (TUM) or 12 (KITTI), found {columns} in line {rows[0][0]}'
    )

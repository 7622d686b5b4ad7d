# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Trajectory files: TUM (stamp x y z qx qy qz qw) in full precision, KITTI rows of 12 numbers."""

from __future__ import annotations

import itertools
import logging
import math
import statistics
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.core.quaternion import from_quaternion, to_quaternion
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.metrics.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

logger = logging.getLogger(__name__)

KITTI_PERIOD_S = 0.1
_OTHER_UNITS = (
    ('ns', 10**9, 10**17, 1e6),
    ('us', 10**6, 10**14, 1e4),
    ('ms', 10**3, 10**11, float('inf')),
)
"""Unit, how many make a second, and which numbers cannot be seconds: larger ones, or those with a
larger median step."""
_LOOSE = 0.02
"""Rounded to three digits, a rotation is still one."""


def tum_row(stamp: int, pose: NDArray[np.float64]) -> str:
    """One line of a TUM file: nanoseconds kept exactly, the rest with 17 significant digits.

    Args:
        stamp: ns.
        pose: (4, 4) T_world_sensor, metres.
    """
    sec, nanosec = divmod(int(stamp), NS_PER_S)
    numbers = (*(float(v) for v in pose[:3, 3]), *to_quaternion(pose[:3, :3]))
    return f'{sec}.{nanosec:09d} ' + ' '.join(f'{v:.17g}' for v in numbers)


def text_of(path: Path) -> str:
    """Content of a text file.

    Raises:
        FileFormatError: missing, or not text.
    """
    try:
        return path.read_text(encoding='utf-8')
    except FileNotFoundError:
        raise FileFormatError(f'no file at {path}') from None
    except (UnicodeDecodeError, IsADirectoryError):
        raise FileFormatError(f'{path} is not a text file') from None


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Line number and fields of every line that is neither empty nor a comment."""
    numbered = enumerate(text_of(path).splitlines(), 1)
    lines = ((n, line.replace(',', ' ').split()) for n, line in numbered)
    return [(n, fields) for n, fields in lines if fields and not fields[0].startswith('#')]


def stamp_ns(text: str) -> int:
    """Nanoseconds of a decimal number of seconds, without going through a float.

    Raises:
        ValueError: it is no finite number.
    """
    sign = -1 if text.startswith('-') else 1
    whole, _, part = text.lstrip('+-').partition('.')
    if (whole + part).isascii() and (whole + part).isdigit():
        return sign * (int(whole or 0) * NS_PER_S + int((part + '0' * 9)[:9]))
    seconds = float(text)
    if not math.isfinite(seconds):
        raise ValueError(f'stamp {text}')
    return round(seconds * NS_PER_S)


def in_seconds(path: Path, stamps: Sequence[int]) -> NDArray[np.int64]:
    """Stamps in ns, (N,), of numbers read as seconds; ms, us and ns are recognised.

    Args:
        path: file, for the messages.
        stamps: its numbers times 1e9.

    Raises:
        FileFormatError: no unit makes plausible times of them.
    """
    ordered = sorted(stamps)
    steps = [b - a for a, b in itertools.pairwise(ordered) if b > a]
    step_s = statistics.median(steps) / NS_PER_S if steps else 0.0
    largest_s = max(abs(ordered[0]), abs(ordered[-1])) // NS_PER_S
    for unit, per_second, epoch_s, usual_step_s in _OTHER_UNITS:
        if largest_s > epoch_s or step_s >= usual_step_s:
            logger.warning('%s: its stamps are taken as %s', path, unit)
            stamps = [stamp // per_second for stamp in stamps]
            break
    if max(abs(s) for s in stamps) >= 2**63:
        raise FileFormatError(
            f'{path}: a stamp of {float(largest_s):.4g} is no time: expected seconds (ms, us and '
            'ns are recognised)'
        )
    return np.array(stamps, dtype=np.int64)


def read_tum(path: Path) -> Trajectory:
    """Read a TUM file; stamps may be in ms, us or ns instead of seconds.

    Raises:
        FileFormatError: missing, not text, a line has not 8 numbers or no unit quaternion, or two
            lines have the same stamp.
    """
    stamps, poses, lines = [], [], []
    for number, fields in _rows(path):
        try:
            if len(fields) != 8:
                raise ValueError(f'{len(fields)} columns')
            values = [float(v) for v in fields]
            if not np.isfinite(values).all():
                raise ValueError('a number that is not finite')
            stamps.append(stamp_ns(fields[0]))
        except ValueError as error:
            raise FileFormatError(
                f'{path} line {number}: expected stamp x y z qx qy qz qw, found {error}'
            ) from None
        try:
            R = from_quaternion(*values[4:])
        except FileFormatError as error:
            raise FileFormatError(f'{path} line {number}: {error}') from None
        poses.append(se3.transform(R, np.array(values[1:4])))
        lines.append(number)
    if not poses:
        raise FileFormatError(f'{path} holds no pose')
    order = np.argsort(np.array(stamps, dtype=object), kind='stable')
    exact = in_seconds(path, stamps)[order]
    for row in np.flatnonzero(np.diff(exact) <= 0)[:1] + 1:
        raise FileFormatError(
            f'{path} line {lines[order[row]]}: stamps must increase, this one is that of '
            f'line {lines[order[row - 1]]}'
        )
    return Trajectory(exact, np.array(poses)[order])


def read_kitti_rows(path: Path) -> NDArray[np.float64]:
    """KITTI poses (N, 4, 4): one 3x4 matrix a line, row-major.

    Raises:
        FileFormatError: missing, empty, or a line has not 12 numbers of a rigid transform.
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
        if not se3.is_rigid(T, _LOOSE):
            raise FileFormatError(f'{path} line {number}: its 3x4 matrix is no rigid transform')
        poses.append(se3.orthonormalise(T))
    if not poses:
        raise FileFormatError(f'{path} holds no pose')
    return np.array(poses)


def read_times(path: Path) -> list[int]:
    """Stamps in ns of a file with one number of seconds (or ms, us, ns) a line.

    Raises:
        FileFormatError: missing, or a line is not a number.
    """
    stamps = []
    for number, fields in _rows(path):
        try:
            stamps.append(stamp_ns(fields[0]))
        except (ValueError, OverflowError):
            raise FileFormatError(
                f'{path} line {number}: expected seconds, found {fields[0]!r}'
            ) from None
    return in_seconds(path, stamps).tolist() if stamps else []


def read_listing(path: Path) -> list[tuple[int, str]]:
    """Stamp (ns) and file name of every line of a TUM listing such as depth.txt.

    Raises:
        FileFormatError: missing, empty, or a line is not `stamp file`.
    """
    stamps, names = [], []
    for number, fields in _rows(path):
        try:
            stamps.append(stamp_ns(fields[0]))
            names.append(fields[1])
        except (ValueError, IndexError):
            raise FileFormatError(f'{path} line {number}: expected stamp and file name') from None
    if not names:
        raise FileFormatError(f'{path} lists no file')
    return sorted(zip(in_seconds(path, stamps).tolist(), names, strict=True))


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

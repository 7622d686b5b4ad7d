# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Cloud files of every format, written byte by byte here: exact values and one-line errors."""

from __future__ import annotations

import doctest
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.loaders import lzf
from hybridreg_ros.data.loaders.clouds import read_cloud

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray


def cloud(n: int = 50) -> NDArray[np.float32]:
    return np.random.default_rng(2).normal(0, 5, (n, 3)).astype(np.float32)


def write_npy(path: Path, points: NDArray[np.float32]) -> None:
    np.save(path, points)


def write_npz(path: Path, points: NDArray[np.float32]) -> None:
    np.savez(path, points=points, other=np.zeros(3))


def write_bin(path: Path, points: NDArray[np.float32]) -> None:
    np.hstack([points, np.ones((len(points), 1), np.float32)]).tofile(path)


def write_ply(path: Path, points: NDArray[np.float32], kind: str = 'ascii') -> None:
    header = (
        f'ply\nformat {kind} 1.0\ncomment test\nelement vertex {len(points)}\n'
        'property uchar red\nproperty float x\nproperty float y\nproperty double z\n'
        'element face 1\nproperty list uchar int vertex_indices\nend_header\n'
    )
    if kind == 'ascii':
        body = ''.join(f'7 {x!r} {y!r} {z!r}\n' for x, y, z in points.astype(float).tolist())
        path.write_text(header + body + '3 0 1 2\n')
        return
    order = '<' if 'little' in kind else '>'
    table = np.zeros(
        len(points), [('r', 'u1'), ('x', f'{order}f4'), ('y', f'{order}f4'), ('z', f'{order}f8')]
    )
    table['x'], table['y'], table['z'] = points.T
    path.write_bytes(header.encode() + table.tobytes() + b'\x03' + bytes(12))


def write_pcd(path: Path, points: NDArray[np.float32], kind: str = 'ascii') -> None:
    header = (
        '# .PCD v0.7\nVERSION 0.7\nFIELDS x y z _ normal _\nSIZE 4 4 4 1 4 1\nTYPE F F F U F U\n'
        f'COUNT 1 1 1 4 3 2\nWIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n'
        f'POINTS {len(points)}\nDATA {kind}\n'
    )
    columns = [points[:, :1], points[:, 1:2], points[:, 2:]]
    extra = [np.zeros((len(points), 4), 'u1'), np.ones((len(points), 3), 'f4')]
    fields = [*columns, *extra, np.zeros((len(points), 2), 'u1')]
    if kind == 'ascii':
        rows = np.hstack([f.astype(float) for f in fields]).tolist()
        path.write_text(header + '\n'.join(' '.join(f'{v!r}' for v in row) for row in rows))
    elif kind == 'binary':
        rows = b''.join(f[i].tobytes() for i in range(len(points)) for f in fields)
        path.write_bytes(header.encode() + rows)
    else:
        plain = b''.join(np.ascontiguousarray(f).tobytes() for f in fields)
        packed = b''.join(
            bytes([len(plain[i : i + 32]) - 1]) + plain[i : i + 32]
            for i in range(0, len(plain), 32)
        )
        sizes = np.array([len(packed), len(plain)], '<u4').tobytes()
        path.write_bytes(header.encode() + sizes + packed)


@pytest.mark.parametrize(
    ('name', 'write'),
    [
        ('a.npy', write_npy),
        ('a.npz', write_npz),
        ('a.bin', write_bin),
        ('a.ply', write_ply),
        ('l.ply', lambda p, c: write_ply(p, c, 'binary_little_endian')),
        ('b.ply', lambda p, c: write_ply(p, c, 'binary_big_endian')),
        ('a.pcd', write_pcd),
        ('b.pcd', lambda p, c: write_pcd(p, c, 'binary')),
        ('c.PCD', lambda p, c: write_pcd(p, c, 'binary_compressed')),
    ],
)
def test_cloud_formats(
    tmp_path: Path, name: str, write: Callable[[Path, NDArray[np.float32]], None]
) -> None:
    write(tmp_path / name, cloud())
    loaded = read_cloud(tmp_path / name)
    assert loaded.dtype == np.float32
    assert np.array_equal(loaded, cloud())
    if name not in ('a.npy', 'a.npz'):
        data = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(data[: len(data) // 2 - 1])
        with pytest.raises(FileFormatError, match='is not a readable'):
            read_cloud(tmp_path / name)


def test_bad_clouds(tmp_path: Path) -> None:
    cases: dict[str, tuple[bytes, str]] = {
        'a.xyz': (b'', r'expected one of \.npy'),
        'a.npy': (b'no array', 'is not a readable .npy'),
        'a.npz': (b'no archive', 'is not a readable .npz'),
        'a.bin': (b'12345', '5 bytes are no rows of float32'),
        'a.ply': (b'play', 'expected it to begin with "ply"'),
        'b.ply': (b'ply\nformat ascii 1.0\n', 'no end_header line: expected'),
        'c.ply': (
            b'ply\nformat ascii 1.0\nelement face 1\nend_header\n',
            'expected an element vertex',
        ),
        'e.ply': (b'ply\nformat 7\nend_header\n', "expected format ascii, .* found '7'"),
        'f.ply': (b'ply\nelement vertex\nend_header\n', "not understood: 'element vertex'"),
        'g.ply': (b'ply\nelement vertex x\nend_header\n', 'expected a number of points'),
        'h.ply': (
            b'ply\nelement vertex 1\nproperty half x\nend_header\n',
            'expected a property type',
        ),
        'i.ply': (
            b'ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n'
            b'property float z\nend_header\n1 2\n',
            'point 0: expected 3 numbers',
        ),
        'c.pcd': (b'#\nSIZE 4\nDATA binary\n', 'its header has no FIELDS'),
        'd.pcd': (
            b'FIELDS x y z\nTYPE F F G\nSIZE 4 4 4\nPOINTS 0\nDATA binary\n',
            'expected TYPE F, I or U .* found G4',
        ),
        'e.pcd': (b'FIELDS x y z\nTYPE F F\nSIZE 4 4 4\nPOINTS 0\nDATA binary\n', 'found 2 and 3'),
        'f.pcd': (b'FIELDS x y z\nPOINTS -1\nDATA ascii\n', 'POINTS: expected a number'),
        'g.pcd': (b'FIELDS x y z\nCOUNT 1\nPOINTS 1\nDATA ascii\n', 'expected COUNT of 3 fields'),
        'd.ply': (
            b'ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float x\n'
            b'end_header\n',
            'no field y, z; found x',
        ),
        'a.pcd': (b'VERSION 0.7\n', 'no DATA line'),
        'b.pcd': (b'FIELDS x\nSIZE 4\nTYPE F\nPOINTS 0\nDATA packed\n', 'unknown DATA packed'),
    }
    for name, (data, text) in cases.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(FileFormatError, match=text):
            read_cloud(tmp_path / name)
    with pytest.raises(FileFormatError, match=r'cannot read cloud .*No such file'):
        read_cloud(tmp_path / 'gone.ply')
    np.save(tmp_path / 'flat.npy', np.zeros(9))
    with pytest.raises(FileFormatError, match=r'expected numbers of shape \(N, 3\)'):
        read_cloud(tmp_path / 'flat.npy')
    np.savez(tmp_path / 'names.npz', a=np.zeros((1, 3)))
    with pytest.raises(FileFormatError, match=r'no array named points.*found a'):
        read_cloud(tmp_path / 'names.npz')
    np.save(tmp_path / 'object.npy', np.array([{'a': 1}], dtype=object), allow_pickle=True)
    with pytest.raises(FileFormatError, match='allow_pickle=False'):
        read_cloud(tmp_path / 'object.npy')


def test_lzf() -> None:
    assert doctest.testmod(lzf).failed == 0
    # literal 'ab', then 2 + 7 + 3 bytes from 2 back
    assert lzf.decompress(bytes([1, 97, 98, 0xE0, 3, 1]), 14) == b'ab' * 7
    for packed, text in (
        (bytes([0x80]), 'cut off'),
        (bytes([0x80, 2]), 'before their beginning'),
        (bytes([0, 97]), 'hold 1 bytes, expected 5'),
        (bytes([0, 97, 0xE0, 255, 0]), 'hold more than 5 bytes'),
    ):
        with pytest.raises(ValueError, match=text):
            lzf.decompress(packed, 5)


@pytest.mark.parametrize('kind', ['ascii', 'binary_little_endian', 'binary_big_endian'])
@pytest.mark.parametrize('lists', [True, False])
def test_ply_whose_first_element_is_not_the_vertices(
    tmp_path: Path, kind: str, lists: bool
) -> None:
    """Faces, or a camera, stand before the vertices; x y z are written in capital letters."""
    points = cloud(5)
    faces = 'property list uchar int vertex_indices\n' if lists else 'property short a\n'
    header = (
        f'ply\nformat {kind} 1.0\nelement face 2\n{faces}element vertex 5\nproperty float X\n'
        'property float Y\nproperty uchar label\nproperty uchar label\nproperty float Z\n'
        'end_header\n'
    )
    order = '>' if 'big' in kind else '<'
    if kind == 'ascii':
        body = '3 0 1 2\n4 0 1 2 3\n' if lists else '1\n2\n'
        body += ''.join(f'{x!r} {y!r} 7 8 {z!r}\n' for x, y, z in points.astype(float).tolist())
        data = body.encode()
    else:
        long = np.arange(4, dtype=f'{order}i4').tobytes()
        data = b'\x03' + long[:12] + b'\x04' + long if lists else b'\x00\x01\x00\x02'
        table = np.zeros(
            5, [('x', f'{order}f4'), ('y', f'{order}f4'), ('l', 'u2'), ('z', f'{order}f4')]
        )
        table['x'], table['y'], table['z'] = points.T
        data += table.tobytes()
    path = tmp_path / 'a.ply'
    path.write_bytes(header.encode() + data)
    assert np.array_equal(read_cloud(path), points)
    path.write_bytes(header.encode() + data[:3])
    with pytest.raises(FileFormatError, match='cut off'):
        read_cloud(path)


@pytest.mark.parametrize('kind', ['ascii', 'binary', 'binary_compressed'])
def test_pcd_in_small_letters_with_doubled_fields(tmp_path: Path, kind: str) -> None:
    write_pcd(tmp_path / 'a.pcd', cloud(), kind)
    data = (tmp_path / 'a.pcd').read_bytes()
    for old, new in (
        (b'TYPE F F F U F U', b'TYPE f f f u f u'),
        (b'FIELDS x y z _ normal _', b'FIELDS X Y Z _ X _'),
        (f'POINTS {len(cloud())}\n'.encode(), b''),
    ):
        assert old in data
        data = data.replace(old, new)
    (tmp_path / 'a.pcd').write_bytes(data)
    assert np.array_equal(read_cloud(tmp_path / 'a.pcd'), cloud())


@pytest.mark.parametrize(
    'name',
    ['a.npy', 'a.ply', 'b.ply', 'a.pcd', 'b.pcd'],
)
def test_what_follows_the_last_point_is_told(
    tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    """A header that announces fewer points than there are."""
    path = tmp_path / name
    if name == 'a.npy':
        write_npy(path, cloud(10))
    elif name.endswith('pcd'):
        write_pcd(path, cloud(10), 'ascii' if name[0] == 'a' else 'binary')
    else:
        kind = 'ascii' if name[0] == 'a' else 'binary_little_endian'
        write_ply(path, cloud(10), kind)
        data = path.read_bytes().replace(
            b'element face 1\nproperty list uchar int vertex_indices\n', b''
        )
        path.write_bytes(data[: -8 if kind == 'ascii' else -13])
    assert len(read_cloud(path)) == 10
    assert caplog.text == ''
    data = path.read_bytes()
    for old in (b'(10, 3)', b'vertex 10', b'POINTS 10'):
        data = data.replace(old, old.replace(b'10', b' 8'))
    path.write_bytes(data)
    assert len(read_cloud(path)) == 8
    assert f'{path}: ' in caplog.text
    assert 'bytes follow the last point that is announced' in caplog.text


def turn(n: int = 600, columns: int = 4) -> NDArray[np.float32]:
    """A lidar's rows x y z intensity ring time, or fewer columns of them."""
    rng = np.random.default_rng(5)
    angle = np.linspace(0, 2 * np.pi, n)
    far = rng.uniform(4, 30, n)
    table = [far * np.cos(angle), far * np.sin(angle), rng.uniform(-2, 3, n)]
    rest = [rng.uniform(0, 1, n), np.arange(n) % 32, np.linspace(0, 0.1, n)]
    return np.column_stack([*table, *rest])[:, :columns].astype('<f4')


@pytest.mark.parametrize('columns', [3, 4, 5, 6])
@pytest.mark.parametrize('order', ['as measured', 'shuffled'])
def test_headerless_columns_are_told_by_the_values(
    tmp_path: Path, columns: int, order: str
) -> None:
    """600 rows: every number of columns from 3 to 6 divides the size."""
    rows = turn(columns=columns)
    rows = rows if order == 'as measured' else np.random.default_rng(1).permutation(rows)
    rows.tofile(tmp_path / 'a.bin')
    assert np.array_equal(read_cloud(tmp_path / 'a.bin'), rows[:, :3])
    rows.ravel()[:-1].tofile(tmp_path / 'cut.bin')
    with pytest.raises(FileFormatError, match=f'not a multiple of {4 * columns} .*cut off'):
        read_cloud(tmp_path / 'cut.bin')


def test_headerless_files_that_hold_no_points(tmp_path: Path) -> None:
    path = tmp_path / 'a.bin'
    np.linspace(0, 0.1, 600, dtype='<f4').tofile(path)
    with pytest.raises(FileFormatError, match='as if they were no points'):
        read_cloud(path)
    turn().astype('<f8').tofile(path)
    with pytest.raises(FileFormatError, match=r'no coordinates in metres|do not tell'):
        read_cloud(path)
    path.write_bytes(b'# .PCD v0.7 a text file of some length, as long as it takes here' * 12)
    with pytest.raises(FileFormatError, match=r'is not a readable \.bin cloud'):
        read_cloud(path)
    path.write_bytes(b'')
    with pytest.raises(FileFormatError, match='0 bytes are no rows'):
        read_cloud(path)
    np.zeros((5, 7), '<f4').tofile(path)
    with pytest.raises(FileFormatError, match=r'140 bytes are not a multiple of 16'):
        read_cloud(path)
    assert read_cloud(path, 7).shape == (5, 3)
    with pytest.raises(FileFormatError, match=r'not a multiple of 24 \(6 columns\)'):
        read_cloud(path, 6)
    rng = np.random.default_rng(0)
    even, odd = rng.normal(0, 1, (600, 3)), rng.normal(0, 9, (600, 3))
    np.stack([even, odd]).transpose(1, 0, 2).astype('<f4').tofile(path)
    assert len(read_cloud(path, 3)) == 1200


def test_points_as_columns(tmp_path: Path) -> None:
    """(3, N) and (4, N) are turned over; what can be neither is refused."""
    for name, array in (('a.npy', cloud().T), ('b.npy', np.vstack([cloud().T, np.ones(50)]))):
        np.save(tmp_path / name, array)
        assert np.array_equal(read_cloud(tmp_path / name), cloud())
    np.savez(tmp_path / 'a.npz', points=cloud().T)
    assert np.array_equal(read_cloud(tmp_path / 'a.npz'), cloud())
    np.save(tmp_path / 'few.npy', cloud(3))
    assert np.array_equal(read_cloud(tmp_path / 'few.npy'), cloud(3))
    np.save(tmp_path / 'c.npy', np.zeros((40, 500)))
    with pytest.raises(FileFormatError, match=r'shape \(40, 500\): expected \(N, 3\)'):
        read_cloud(tmp_path / 'c.npy')

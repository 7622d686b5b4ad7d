# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Shards: what goes in comes out, and broken files are said, not guessed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.hybridmatch.shards import (
    decode_pair,
    encode_pair,
    open_split,
    read_blobs,
    read_offsets,
    write_shard,
)
from hybridreg_ros.data.pair import PointPair

if TYPE_CHECKING:
    from pathlib import Path


def tiny(seed: int, count: int = 200, reach: float = 3.0) -> PointPair:
    rng = np.random.default_rng(seed)

    def side(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        label = rng.integers(0, 3, n).astype(np.uint8)
        instance = np.where(label > 0, rng.integers(1, 400, n), 0).astype(np.uint16)
        return rng.uniform(-reach, reach, (n, 3)).astype(np.float32), label, instance

    (a, a_label, a_instance), (b, b_label, b_instance) = side(count), side(count + 17)
    T = np.eye(4)
    T[:3, 3] = rng.normal(size=3)
    return PointPair(
        a, b, T, a_label, b_label, a_instance, b_instance, 0.4, 0.2, 0.05, f'tiny-{seed}', seed
    )


def check_same(one: PointPair, two: PointPair, step: float = 0.001) -> None:
    for side in ('source', 'target'):
        np.testing.assert_allclose(getattr(one, side), getattr(two, side), atol=0.501 * step)
        for what in ('label', 'instance'):
            name = f'{side}_{what}'
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
            assert getattr(one, name).dtype == getattr(two, name).dtype
    np.testing.assert_array_equal(one.T_target_source, two.T_target_source)
    assert (one.overlap, one.dynamic_share, one.voxel_size_m, one.name, one.seed) == (
        two.overlap,
        two.dynamic_share,
        two.voxel_size_m,
        two.name,
        two.seed,
    )


def test_a_pair_survives_up_to_a_millimetre() -> None:
    check_same(decode_pair(encode_pair(tiny(1))), tiny(1))


def test_large_scenes_are_rounded_more_coarsely() -> None:
    pair = tiny(2, reach=90.0)
    check_same(decode_pair(encode_pair(pair)), pair, 0.003)


def test_encoding_again_changes_nothing() -> None:
    blob = encode_pair(tiny(3))
    assert encode_pair(decode_pair(blob)) == blob


def test_an_empty_cloud_is_kept() -> None:
    pair = tiny(4)
    none = replace(
        pair,
        source=pair.source[:0],
        source_label=pair.source_label[:0],
        source_instance=pair.source_instance[:0],
    )
    check_same(decode_pair(encode_pair(none)), none)


def test_a_folder_of_shards_is_a_sequence(tmp_path: Path) -> None:
    pairs = [tiny(k) for k in range(5)]
    write_shard(tmp_path / 'b.hrs', [encode_pair(p) for p in pairs[3:]])
    write_shard(tmp_path / 'a.hrs', [encode_pair(p) for p in pairs[:3]])
    split = open_split(tmp_path)
    assert [p.name for p in split] == [p.name for p in pairs]
    check_same(split[4], pairs[4])
    check_same(split[-1], pairs[4])
    assert [p.name for p in split[1:3]] == ['tiny-1', 'tiny-2']
    with pytest.raises(IndexError):
        split[5]


def test_new_shards_are_taken_up_and_numbers_kept(tmp_path: Path) -> None:
    write_shard(tmp_path / '2.hrs', [encode_pair(tiny(2))])
    split = open_split(tmp_path)
    write_shard(tmp_path / '1.hrs', [encode_pair(tiny(1))])
    assert len(split) == 1
    assert split.refresh() == 2
    assert [p.name for p in split] == ['tiny-2', 'tiny-1']


def test_an_empty_shard_and_an_empty_folder(tmp_path: Path) -> None:
    assert len(open_split(tmp_path)) == 0
    write_shard(tmp_path / 'none.hrs', [])
    assert len(open_split(tmp_path)) == 0
    assert read_blobs(tmp_path / 'none.hrs') == []


def test_a_shard_appears_complete_or_not_at_all(tmp_path: Path) -> None:
    def failing():
        yield b'one'
        raise OSError('disk full')

    with pytest.raises(OSError, match='disk full'):
        write_shard(tmp_path / 'x.hrs', failing())
    assert not (tmp_path / 'x.hrs').exists()
    write_shard(tmp_path / 'x.hrs', [b'one', b'two'])
    assert read_blobs(tmp_path / 'x.hrs') == [b'one', b'two']
    assert [p.name for p in tmp_path.iterdir()] == ['x.hrs']


def test_broken_shards_are_said(tmp_path: Path) -> None:
    path = tmp_path / 'x.hrs'
    with pytest.raises(FileFormatError, match='cannot read shard'):
        read_offsets(path)
    path.write_bytes(b'not a shard at all')
    with pytest.raises(FileFormatError, match='is not a shard'):
        read_offsets(path)
    write_shard(path, [encode_pair(tiny(1)), encode_pair(tiny(2))])
    whole = path.read_bytes()
    for cut in (len(whole) - 1, 20, 14):
        path.write_bytes(whole[:cut])
        with pytest.raises(FileFormatError, match='truncated'):
            open_split(tmp_path)
    with pytest.raises(FileFormatError, match='no split at'):
        open_split(tmp_path / 'nowhere')


@pytest.mark.parametrize('damage', ['cut', 'flipped', 'foreign'])
def test_broken_pairs_are_said(damage: str) -> None:
    blob = encode_pair(tiny(1))
    if damage == 'cut':
        blob = blob[: len(blob) // 2]
    elif damage == 'flipped':
        blob = blob[:50] + bytes([blob[50] ^ 255]) + blob[51:]
    else:
        blob = b'PK0123456789'
    with pytest.raises(FileFormatError, match='cannot be read'):
        decode_pair(blob)


def test_a_vanished_shard_is_said(tmp_path: Path) -> None:
    write_shard(tmp_path / 'x.hrs', [encode_pair(tiny(1))])
    split = open_split(tmp_path)
    (tmp_path / 'x.hrs').unlink()
    with pytest.raises(FileFormatError, match='cannot read shard'):
        split[0]

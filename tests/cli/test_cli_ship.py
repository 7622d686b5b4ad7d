# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg ship`: what it writes can be loaded; what cannot be fitted is said in one line."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.cli.main import main
from hybridreg_ros.data.hybridmatch.room_pairs import make_pairs
from hybridreg_ros.data.hybridmatch.shards import encode_pair, write_shard
from hybridreg_ros.model.checkpoint import load_checkpoint, packaged_weights

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope='module')
def pairs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pairs that register, and two of clouds that have nothing in common."""
    folder = tmp_path_factory.mktemp('val') / 'room-match-rigid'
    good = make_pairs('room-match-rigid', 5_600_000, 2)[:2]
    rng = np.random.default_rng(0)
    bad = [
        dataclasses.replace(
            pair,
            target=np.ascontiguousarray(
                pair.target + rng.uniform(-1.5, 1.5, pair.target.shape), dtype=np.float32
            ),
            name=f'room-match-rigid-9{k:06d}',
        )
        for k, pair in enumerate(good)
    ]
    folder.mkdir()
    write_shard(folder / 'a.hrs', [encode_pair(p) for p in (*good, *bad)])
    return folder


def test_writes_weights_with_a_fitted_confidence(pairs: Path, tmp_path: Path) -> None:
    out = tmp_path / 'new.safetensors'
    assert main(['ship', str(packaged_weights()), str(pairs), '--out', str(out)]) == 0
    shipped = load_checkpoint(out)
    assert shipped.calibration.fitted
    assert shipped.calibration != load_checkpoint(packaged_weights()).calibration
    assert out.stat().st_size < 12e6


def test_one_line_for_a_missing_checkpoint(
    pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(['ship', str(tmp_path / 'no'), str(pairs), '--out', str(tmp_path / 'x')])
    assert code == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1

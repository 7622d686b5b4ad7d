# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Weights files: round trip, and one clear line for each bad one."""

from __future__ import annotations

import dataclasses
import json
import pickle
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from hybridreg_ros.core.errors import ConfigError, WeightsError
from hybridreg_ros.model import checkpoint
from hybridreg_ros.model.pose.confidence import ConfidenceFeatures, PairCalibration, feature_names

if TYPE_CHECKING:
    from pathlib import Path

    from hybridreg_ros.model.reference.network import HybridRegNet


@pytest.fixture
def weights(tmp_path: Path, compact_net: HybridRegNet) -> Path:
    path = tmp_path / 'w.safetensors'
    calibration = PairCalibration(bias=-3.0, fitted=True)
    checkpoint.save_network(path, compact_net, {'steps': 5}, calibration)
    return path


def test_round_trip(weights: Path, compact_net: HybridRegNet) -> None:
    loaded = checkpoint.load_checkpoint(weights)
    assert loaded.config == loaded.network.config == compact_net.config
    assert loaded.provenance == {'steps': 5}
    assert loaded.calibration == PairCalibration(bias=-3.0, fitted=True)
    assert not loaded.network.training
    for name, value in compact_net.state_dict().items():
        assert torch.equal(loaded.network.state_dict()[name], value)
    assert weights.stat().st_size < 12_000_000


def test_half_is_half_the_size_and_loads_as_float32(
    tmp_path: Path, weights: Path, compact_net: HybridRegNet
) -> None:
    half = tmp_path / 'half.safetensors'
    checkpoint.save_network(half, compact_net, {}, half=True)
    assert half.stat().st_size < 0.55 * weights.stat().st_size
    loaded = checkpoint.load_checkpoint(half).network.state_dict()
    for name, value in compact_net.state_dict().items():
        assert loaded[name].dtype == torch.float32
        torch.testing.assert_close(loaded[name], value, atol=1e-3, rtol=1e-3)


def test_missing(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match=r'cannot read weights .*No such file'):
        checkpoint.load_checkpoint(tmp_path / 'none.safetensors')


@pytest.mark.parametrize('keep', [0, 5, 300, 100_000])
def test_truncated(weights: Path, keep: int) -> None:
    weights.write_bytes(weights.read_bytes()[:keep])
    with pytest.raises(WeightsError, match='truncated or not a safetensors file'):
        checkpoint.load_checkpoint(weights)


def test_foreign_safetensors(tmp_path: Path) -> None:
    path = tmp_path / 'foreign.safetensors'
    save_file({'x': torch.zeros(3)}, str(path))
    with pytest.raises(WeightsError, match='without HybridReg metadata'):
        checkpoint.load_checkpoint(path)


class _Trap:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (exec, ("raise SystemExit('unpickled')",))


def test_pickles_are_never_opened(tmp_path: Path) -> None:
    plain, zipped = tmp_path / 'a.pt', tmp_path / 'b.safetensors'
    plain.write_bytes(pickle.dumps(_Trap()))
    torch.save({'x': torch.zeros(2)}, zipped)
    for path in (plain, zipped):
        with pytest.raises(
            WeightsError, match=r'pickle or torch.save file, which is never opened'
        ):
            checkpoint.load_checkpoint(path)


def _rewrite(path: Path, change: dict[str, torch.Tensor | None], **metadata: str) -> None:
    tensors = load_file(str(path))
    meta = {
        'format': checkpoint.FORMAT,
        'config': '{}',
        'calibration': '{}',
        'provenance': '{}',
        **metadata,
    }
    for name, value in change.items():
        if value is None:
            del tensors[name]
        else:
            tensors[name] = value
    save_file(tensors, str(path), meta)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'output.weight': torch.zeros(3, 3)}, r'output.weight expected shape \(128, 128\)'),
        ({'output.weight': None}, r'parameter output.weight is missing'),
        ({'surplus': torch.zeros(1)}, r'1 unknown parameters \(surplus\)'),
    ],
)
def test_parameters_that_do_not_fit(
    weights: Path, change: dict[str, torch.Tensor | None], message: str
) -> None:
    _rewrite(weights, change)
    with pytest.raises(WeightsError, match=message):
        checkpoint.load_checkpoint(weights)


@pytest.mark.parametrize(
    'metadata',
    [
        {'config': 'no json'},
        {'config': json.dumps({'widht': 3})},
        {'calibration': json.dumps({'weights': [1.0], 'fitted': True})},
    ],
)
def test_unreadable_metadata(weights: Path, metadata: dict[str, str]) -> None:
    _rewrite(weights, {}, **metadata)
    with pytest.raises(WeightsError, match='unreadable metadata'):
        checkpoint.load_checkpoint(weights)


def test_unwritable(tmp_path: Path, compact_net: HybridRegNet) -> None:
    with pytest.raises(WeightsError, match='cannot write weights'):
        checkpoint.save_network(tmp_path / 'no' / 'w.safetensors', compact_net, {})


def test_packaged_weights_are_one_or_said_to_be_none(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(checkpoint, '__file__', str(tmp_path / 'checkpoint.py'))
    with pytest.raises(WeightsError, match='ships no trained weights yet'):
        checkpoint.packaged_weights()
    (tmp_path / 'weights').mkdir()
    (tmp_path / 'weights' / 'a.safetensors').touch()
    assert checkpoint.packaged_weights().name == 'a.safetensors'
    (tmp_path / 'weights' / 'b.safetensors').touch()
    with pytest.raises(WeightsError, match='expected one weights file'):
        checkpoint.packaged_weights()


def test_calibration_checks_its_length() -> None:
    with pytest.raises(ConfigError, match='weights: expected 15 numbers, found 2'):
        PairCalibration(weights=(1.0, 2.0))


def test_logistic_model_alone_is_the_probability_of_a_well_held_result() -> None:
    calibration = PairCalibration()
    held = ConfidenceFeatures(log_inliers=4.0, overlap=0.5, constraint=0.2, support=1000)
    assert calibration.logistic(held.vector()) == pytest.approx(calibration.probability(held))
    loose = dataclasses.replace(held, support=15)
    assert calibration.probability(loose) == pytest.approx(0.1 * calibration.probability(held))
    assert calibration.logistic(np.full(len(feature_names()), np.nan)) == 0.0

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import dataclasses
import importlib.util
from pathlib import Path

import torch

from hybridreg_ros.model.checkpoint import load_checkpoint, packaged_weights
from hybridreg_ros.training.config import TrainConfig

SCRIPT = Path(__file__).parents[2] / 'scripts' / 'ablation.py'


def script():
    spec = importlib.util.spec_from_file_location('ablation', SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_rows_differ_in_the_mask_alone(tmp_path):
    ablation, base = script(), TrainConfig(max_hours=1.5, seed=3)
    rows = {
        name: ablation.row_config(base, name, 'trunk.safetensors', 20, tmp_path)
        for name in ablation.ROWS
    }
    assert len({row.loss for row in rows.values()}) == len(rows)
    assert not rows['e'].loss.masked_correlation
    assert rows['h'].loss == dataclasses.replace(rows['g'].loss, masked_correlation=True)
    for name, row in rows.items():
        assert row.out == str(tmp_path / name)
        assert (row.start_weights, row.steps, row.max_hours) == ('trunk.safetensors', 20, 0.0)
        common = dataclasses.replace(
            row, out=base.out, start_weights='', steps=base.steps, max_hours=1.5, loss=base.loss
        )
        assert common == base


def test_all_rows_start_with_the_same_untrained_mask(tmp_path):
    ablation, trunk = script(), load_checkpoint(packaged_weights()).network.state_dict()
    paths = [ablation.without_mask(packaged_weights(), tmp_path / name) for name in 'ab']
    first, second = (load_checkpoint(path).network.state_dict() for path in paths)
    assert all(torch.equal(first[k], second[k]) for k in first)
    changed = {k.split('.')[0] for k in first if not torch.equal(first[k], trunk[k])}
    assert changed == {'mask'}

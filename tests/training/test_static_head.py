# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The script that trains the static head: the network stays, the file says how it was made."""

from __future__ import annotations

import dataclasses
import importlib.util
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from conftest_training import TINY, make_pair

from hybridreg_ros.data.hybridmatch.shards import encode_pair, write_shard
from hybridreg_ros.data.pair import Label
from hybridreg_ros.metrics.registration import roc_auc
from hybridreg_ros.model.checkpoint import load_checkpoint
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.model.reference.static_head import StaticHead
from hybridreg_ros.model.register import HybridReg

if TYPE_CHECKING:
    from types import ModuleType

HEADED = dataclasses.replace(TINY, static_width=8)


@pytest.fixture(scope='module')
def script() -> ModuleType:
    path = Path(__file__).parents[2] / 'scripts' / 'train_static_head.py'
    spec = importlib.util.spec_from_file_location('train_static_head', path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='module')
def examples(script: ModuleType) -> list[Any]:
    model = HybridReg(HEADED, HybridRegNet(HEADED))
    rng = np.random.default_rng(0)
    return [e for s in range(6) for e in script.examples(model, make_pair(s), rng, False)]


def test_points_left_out_count_through_the_others(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script, 'STATIC', 100)
    monkeypatch.setattr(script, 'THINNED_SHARE', 0.0)
    monkeypatch.setattr(
        script, 'AUGMENT', dataclasses.replace(script.AUGMENT, thin_share=0, crop_share=0)
    )
    pair = make_pair(1)
    model = HybridReg(HEADED, HybridRegNet(HEADED))
    one, _ = script.examples(model, pair, np.random.default_rng(3), False)
    assert (~one.moving).sum() == 100
    assert one.weight.sum() == pytest.approx(len(pair.source), rel=0.1)
    assert one.weight[~one.moving].sum() == pytest.approx(
        (pair.source_label == Label.STATIC).sum(), rel=0.1
    )


def test_a_folded_head_reads_unscaled_numbers(script: ModuleType, examples: list[Any]) -> None:
    torch.manual_seed(0)
    head, scale = StaticHead(HEADED), script.Scale.of(examples)
    with torch.no_grad():
        before = head(*script.batch_of(examples, scale).inputs)
        scale.fold_into(head)
        after = head(*script.batch_of(examples).inputs)
    np.testing.assert_allclose(after, before, atol=1e-3)


def test_a_batch_gives_what_its_examples_give(script: ModuleType, examples: list[Any]) -> None:
    torch.manual_seed(0)
    head = StaticHead(HEADED)
    with torch.no_grad():
        together = head(*script.batch_of(examples[:3]).inputs)
        apart = torch.cat([head(*script.batch_of([e]).inputs) for e in examples[:3]])
    np.testing.assert_allclose(together, apart, atol=1e-4)


def test_the_head_learns(script: ModuleType, examples: list[Any]) -> None:
    torch.manual_seed(0)
    head = StaticHead(HEADED)
    script.fit(head, examples, passes=30, lr=1e-2, seed=0)
    with torch.no_grad():
        static = torch.cat([head(*script.batch_of([e]).inputs)[:, 0] for e in examples]).numpy()
    moving = np.concatenate([e.moving for e in examples])
    assert roc_auc(~moving, static) > 0.9


def test_a_vehicle_is_in_both_clouds_and_static(script: ModuleType) -> None:
    pair = make_pair(2)
    seen = script.seen_from_a_vehicle(pair, np.random.default_rng(1))
    for side in ('source', 'target'):
        points, label = getattr(seen, side), getattr(seen, f'{side}_label')
        body = points[len(getattr(pair, side)) :]
        assert len(points) == len(label)
        assert len(body) > 5
        assert (np.linalg.norm(body, axis=1) < 4.2).all()
        assert not label[len(getattr(pair, side)) :].any()


def test_the_file_differs_in_the_head_alone(
    script: ModuleType,
    tiny_weights: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, out = tmp_path / 'boxes', tmp_path / 'headed.safetensors'
    folder.mkdir()
    write_shard(folder / '0.hrs', [encode_pair(make_pair(s)) for s in range(10, 15)])
    options = ['--weights', str(tiny_weights), '--width', '8', '--passes', '2']
    monkeypatch.setattr('sys.argv', ['train', str(folder), '--out', str(out), *options])
    script.main()
    assert 'boxes clouds 2 auc' in capsys.readouterr().out  # seed 12 is held out
    before, after = load_checkpoint(tiny_weights), load_checkpoint(out)
    assert after.network.config.static_width == 8
    assert after.provenance['static_head']['pairs'] == 4
    assert after.calibration == before.calibration
    trunk = before.network.state_dict()
    for name, values in after.network.state_dict().items():
        if not name.startswith('static.'):
            np.testing.assert_array_equal(values, trunk[name].half().float())

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from conftest_training import TINY, make_pair

from hybridreg_ros.cli.main import main
from hybridreg_ros.data.hybridmatch.shards import encode_pair, write_shard
from hybridreg_ros.data.loaders.labelled import open_labelled
from hybridreg_ros.data.pair import Label
from hybridreg_ros.metrics.registration import roc_auc
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.model.register import HybridReg
from hybridreg_ros.training.moving import Tally, best_iou, histogram_auc, score_moving


def test_the_auc_of_histograms_is_that_of_the_values():
    rng = np.random.default_rng(0)
    values = rng.integers(0, 40, 500)
    truth = rng.random(500) < 0.02 * values
    counts = [np.bincount(values[chosen], minlength=40) for chosen in (truth, ~truth)]
    assert histogram_auc(*counts) == pytest.approx(roc_auc(truth, values.astype(np.float64)))
    assert np.isnan(histogram_auc(counts[0], np.zeros(40, np.int64)))


def test_the_best_iou_is_that_of_the_best_threshold():
    rng = np.random.default_rng(1)
    values = rng.integers(0, 30, 400)
    truth = rng.random(400) < 0.01 * values
    each = [(truth & (values >= t)).sum() / (truth | (values >= t)).sum() for t in range(30)]
    counts = [np.bincount(values[chosen], minlength=30) for chosen in (truth, ~truth)]
    assert best_iou(*counts) == pytest.approx(max(each))
    assert np.isnan(best_iou(np.zeros(30, np.int64), counts[1]))


def test_points_count_by_label_and_distance():
    away = np.array([0.5, 3.0, 10.0, 40.0, 60.0], np.float32)
    points = np.stack([away, np.zeros(5), np.zeros(5)], axis=1).astype(np.float32)
    for label, expected in (
        (Label.STATIC, [3, 0, 0, 2]),
        (Label.MOVING_RIGID, [0, 3, 0, 0]),
        (Label.DEFORMING, [0, 3, 1, 0]),
    ):
        tally = Tally()
        tally.add(
            np.linspace(0.0, 1.0, 5, dtype=np.float32),
            points,
            np.full(5, label, np.uint8),
            np.array([True, True, False, True, True]),
        )
        assert tally.counts.sum(axis=1).tolist() == expected


@pytest.fixture
def generated(tmp_path):
    folder = tmp_path / 'boxes'
    folder.mkdir()
    write_shard(folder / '0.hrs', [encode_pair(make_pair(s)) for s in range(3)])
    return folder


def test_a_folder_gives_one_row(generated):
    source = open_labelled(generated, 0.5)
    config = dataclasses.replace(TINY, static_width=8)
    model = HybridReg(config, HybridRegNet(config))
    row = score_moving(model, map(source.labelled, range(3)), 'boxes').row()
    assert row['data'] == 'boxes'
    assert row['pairs'] == 3
    assert row['moving_share'] == pytest.approx(150 / 1050, abs=0.02)
    for kind in ('network', 'static'):  # not trained
        assert 0.0 <= row[f'AUC_{kind}'] <= 1.0
    assert row['seen_AUC_result'] == row['AUC_result']  # all that stands is seen twice
    assert row['AUC_result'] > 0.5  # the pose of these clouds is found without a trained network
    assert row['RR'] == 1.0


def test_the_command_prints_the_table(generated, tiny_weights, tmp_path, capsys):
    out = tmp_path / 'rows.json'
    code = main(
        [
            'evaluate',
            '--moving',
            str(generated),
            '--weights',
            str(tiny_weights),
            '--limit',
            '2',
            '--max-points',
            '300',
            '--json',
            str(out),
            '--markdown',
            str(tmp_path / 'table.md'),
        ]
    )
    assert code == 0
    table = capsys.readouterr().out
    assert '| boxes | 2 |' in table
    assert ' / - |' in table  # these weights have no static head
    assert (tmp_path / 'table.md').read_text(encoding='utf-8') == table
    found = json.loads(out.read_text(encoding='utf-8'))
    assert found['rows'][0]['pairs'] == 2
    assert found['about']['budget']['max_points'] == 300


def test_other_methods_have_no_mask(generated, capsys):
    assert main(['evaluate', '--moving', str(generated), '--method', 'fpfh']) == 2
    assert 'expected hybridreg with --moving, found fpfh' in capsys.readouterr().err

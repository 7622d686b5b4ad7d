# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest_training import TINY, make_pair

from hybridreg_ros.core import se3
from hybridreg_ros.core.config import dump_yaml, load_yaml
from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.pair import Label
from hybridreg_ros.model.pose.confidence import feature_names
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.model.register import HybridReg
from hybridreg_ros.training.config import TrainConfig
from hybridreg_ros.training.evaluate import (
    GATE,
    calibrate,
    evaluate,
    evaluate_method,
    recorded_pairs,
)
from hybridreg_ros.training.report import (
    EvalReport,
    PairScore,
    score_from_plain,
    score_to_plain,
    summary,
    to_markdown,
)
from hybridreg_ros.training.validation import overlap_points, split_of, threshold_m

REAL = Path(__file__).parents[3] / 'shared' / 'data'


def score(name='a-000001', split='a', rmse=0.1, **changes):
    base = PairScore(
        name=name,
        split=split,
        overlap=0.5,
        dynamic_share=0.1,
        threshold_m=0.2,
        rmse_m=rmse,
        rre_deg=1.0,
        rte_m=rmse,
    )
    return dataclasses.replace(base, **changes)


def test_the_truth_scores_perfectly_and_a_wrong_pose_does_not():
    pairs = [make_pair(s) for s in range(2)]
    report = evaluate_method('truth', lambda p: p.T_target_source, pairs)
    assert report.recall() == 1.0
    assert max(s.rmse_m for s in report.scores) < 1e-9
    shift = se3.transform(np.eye(3), np.array([0.6, 0.0, 0.0]))
    report = evaluate_method('off', lambda p: shift @ p.T_target_source, pairs)
    assert report.recall() == 0.0
    assert report.scores[0].rmse_m == pytest.approx(0.6)
    assert report.scores[0].rte_m == pytest.approx(0.6)


def test_the_network_is_scored_as_users_call_it():
    torch.manual_seed(0)
    model = HybridReg(TINY, HybridRegNet(TINY))
    pair = make_pair(3)
    report = evaluate(model, [pair], {'weights': 'none'})
    (s,) = report.scores
    assert len(s.features) == len(feature_names())
    assert 0.0 <= s.confidence <= 1.0
    assert 0.0 <= s.mask_auc <= 1.0
    assert s.split == 'boxes'
    result = model.register(pair.source, pair.target, pair.voxel_size_m)
    error = np.linalg.norm(result.T_target_source[:3, 3] - pair.T_target_source[:3, 3])
    assert s.rte_m == pytest.approx(error, abs=1e-3)


def test_only_static_points_with_a_counterpart_are_scored():
    pair = make_pair(0)
    points = overlap_points(pair)
    static = pair.source[pair.source_label == Label.STATIC]
    assert len(points) == len(static)
    far = dataclasses.replace(pair, T_target_source=se3.transform(np.eye(3), np.full(3, 50.0)))
    assert len(overlap_points(far)) == 0


def test_names_and_thresholds():
    pair = make_pair(0)
    for name, split in (
        ('room-match-10-30-5000001', 'room-match-10-30'),
        ('room-lomatch-rigid-5000001-3', 'room-lomatch-rigid'),
        ('pairs_3dmatch-redkitchen_0_4', 'pairs_3dmatch'),
    ):
        assert split_of(dataclasses.replace(pair, name=name)) == split
    assert threshold_m(0.05) == 0.2
    assert threshold_m(0.3) == 0.5


def test_summary_by_hand():
    scores = [
        score(rmse=0.1, coarse_rmse_m=0.3, inlier_ratio=0.5, confidence=0.9, seconds=0.1),
        score(rmse=0.3, coarse_rmse_m=0.1, inlier_ratio=0.01, confidence=0.9, seconds=0.3),
        score(rmse=math.inf, confidence=0.1),
    ]
    row = summary('x', scores)
    assert row['RR'] == pytest.approx(1 / 3)
    assert row['RR_coarse'] == pytest.approx(1 / 3)
    assert row['IR'] == pytest.approx(0.255)
    assert row['FMR'] == pytest.approx(0.5)
    assert row['RTE_m'] == pytest.approx(0.1)  # registered pairs only
    assert row['ECE'] == pytest.approx(2 / 3 * 0.4 + 1 / 3 * 0.1)
    assert row['ms'] == pytest.approx(200.0)
    assert math.isnan(summary('none', [])['RR'])


def test_scores_survive_json_and_make_a_table():
    scores = (score(), score(split='b', rmse=math.inf, features=(1.0, math.nan)))
    text = json.dumps([score_to_plain(s) for s in scores])
    plain = json.loads(text, parse_constant=lambda c: pytest.fail(f'{c} is not JSON'))
    again = [score_from_plain(row) for row in plain]
    assert again[0] == scores[0]
    assert not again[1].right
    report = EvalReport('ours', scores)
    table = to_markdown([report, dataclasses.replace(report, method='theirs')])
    lines = table.strip().split('\n')
    assert len(lines) == 2 + 6
    assert [line.split(' | ')[1] for line in lines[2:4]] == ['ours', 'theirs']
    assert '100.0' in lines[2]


def test_calibration_separates_right_from_wrong():
    rng = np.random.default_rng(0)
    fit, intrusion = (feature_names().index(name) for name in ('fit', 'intrusion'))
    scores = []
    for i in range(160):
        right = i % 2 == 0
        features = rng.normal(0, 1, len(feature_names()))
        features[fit] += 3.0 * right
        features[intrusion] += 1.5 * right  # the wrong way round: must not count
        scores.append(score(rmse=0.05 if right else 1.0, features=tuple(features)))
    fitted = calibrate(scores)
    assert fitted.fitted
    assert np.argmax(np.abs(fitted.weights)) == fit
    assert fitted.weights[feature_names().index('trust')] == 0.0
    assert fitted.weights[intrusion] == 0.0
    sure = [
        s
        for s in scores
        if np.dot(fitted.weights, s.features) + fitted.bias > np.log(GATE / (1.0 - GATE))
    ]
    assert len(sure) > 10
    assert np.mean([s.right for s in sure]) > 0.95
    with pytest.raises(ValueError, match='right and wrong'):
        calibrate(scores[::2])


def test_recorded_pairs_in_both_layouts(tmp_path):
    T = se3.exp(np.array([0.1, 0.2, 0.3, 0.1, 0.0, 0.2]))
    cloud = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    single, several = tmp_path / 'single', tmp_path / 'several'
    single.mkdir()
    several.mkdir()
    np.savez(single / 'x.npz', src=cloud, ref=se3.apply(T, cloud), transform=T)
    (single / 'pairs.json').write_text(json.dumps([{'name': 'x', 'overlap_src': 0.9}]))
    np.savez(several / 'fragments.npz', points_0=se3.apply(T, cloud), points_5=cloud)
    rows = [{'ref': 0, 'src': 5, 'overlap': 0.9, 'transform': T.tolist()}]
    (several / 'pairs.json').write_text(json.dumps(rows))
    for folder in (single, several):
        (pair,) = recorded_pairs(folder)
        np.testing.assert_allclose(pair.T_target_source, T, atol=1e-9)
        moved = se3.apply(T, pair.source)
        np.testing.assert_allclose(moved, pair.target, atol=1e-5)
        assert pair.name.startswith(folder.name)
    with pytest.raises(FileFormatError, match='not a folder of recorded pairs'):
        recorded_pairs(tmp_path)


@pytest.mark.real_data
@pytest.mark.parametrize('name', ['pairs_3dmatch', 'pairs_7scenes_fragments'])
def test_real_pairs_align_under_their_truth(name):
    if not (REAL / name).is_dir():
        pytest.skip(f'no real recordings at {REAL / name}')
    pairs = recorded_pairs(REAL / name)
    assert len(pairs) == {'pairs_3dmatch': 5, 'pairs_7scenes_fragments': 39}[name]
    for pair in pairs[:3]:
        assert se3.is_rigid(pair.T_target_source)
        share = len(overlap_points(pair)) / min(len(pair.source), 2000)
        assert share > 0.8 * pair.overlap


def test_yaml_in_config_is_the_default():
    path = Path(__file__).parents[2] / 'config' / 'train.yaml'
    assert path.read_text('utf-8') == dump_yaml(TrainConfig())
    assert load_yaml(TrainConfig, path) == TrainConfig()

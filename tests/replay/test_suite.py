# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Benchmark suites: names, cells, resumption, the table and the fit."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from hybridreg_ros.benchmark import (
    suite_confidence,
    suite_data,
    suite_fit,
    suite_memory,
    suite_plots,
    suite_run,
    suite_table,
)
from hybridreg_ros.benchmark.pipelines import GenzIcp, GicpToKeyframe
from hybridreg_ros.benchmark.suite_data import SuiteFrame
from hybridreg_ros.benchmark.suite_list import METHODS, SEQUENCES, STRIDES, chosen
from hybridreg_ros.cli.main import main
from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import (
    ConfigError,
    DependencyError,
    FileFormatError,
    HybridRegError,
)
from hybridreg_ros.core.scan import Scan
from hybridreg_ros.data.hybridmatch.splits import SEED_RANGES
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.frontend import HybridOdometry
from hybridreg_ros.odometry.selection import calibration

if TYPE_CHECKING:
    from pathlib import Path


def test_suites_are_as_large_as_promised_and_on_new_seeds() -> None:
    scored = chosen('all')
    rooms = [s for s in scored if s.suite == 'rooms']
    streets = [s for s in scored if s.suite == 'streets']
    assert len(rooms) == 10
    assert {s.frames for s in rooms} == {200}
    assert {s.share for s in rooms} == {'none', '10-30', '30-50'}
    assert len(streets) == 6
    assert len([s for s in scored if s.suite == 'real']) == 5
    seeds = [s.seed for s in (*rooms, *streets)]
    assert len(set(seeds)) == 16
    # Neither trained on, nor tuned on, nor reserved for outside checks.
    assert min(seeds) >= SEED_RANGES['train'][1]
    assert not set(seeds) & {s.seed for s in chosen('dev')}
    assert max(seeds) < SEED_RANGES['test'][1]
    assert STRIDES == (1, 2, 5, 10)
    assert not {s.name for s in chosen('dev')} & {s.name for s in scored}


REPORTED = json.dumps(dict.fromkeys(calibration.REPORTED, 1))
WITH = (
    '{"evidence": {"bias": 0, "weights": %s}, "covariance_scale": %s, '
    f'"confidence": {{"bias": 0, "weights": {REPORTED}}}}}'
)
WEIGHTS = json.dumps(dict.fromkeys(calibration.EVIDENCE, 1))


def test_unknown_names_are_errors() -> None:
    with pytest.raises(ConfigError, match='--suite: expected all, rooms'):
        chosen('attic')
    with pytest.raises(ConfigError, match="'room-99' is not in suite rooms"):
        chosen('rooms', ['room-99'])
    with pytest.raises(ConfigError, match='--methods: expected some of ours'):
        suite_run.config_of('magic', OdometryConfig())
    assert [s.frames for s in chosen('rooms', ['room-03'], 7)] == [7]


def test_missing_recording_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match='give its folder with --data'):
        suite_data.load(SEQUENCES['lidar_balm_walk_a'], tmp_path, tmp_path)


def frame(k: int, x: float, points: int = 400) -> SuiteFrame:
    rng = np.random.default_rng(0)
    world = rng.uniform(-3.0, 3.0, (points, 3)) + np.array([4.0, 0.0, 0.0])
    pose = se3.transform(np.eye(3), np.array([x, 0.0, 0.0]))
    cloud = (world - [x, 0.0, 0.0]).astype(np.float32)
    stamp = 10**9 + k * 10**8
    return SuiteFrame(Scan(cloud, stamp=stamp), pose, np.arange(points) < 10)


def test_a_step_out_and_back_is_one_wrong_pose_and_two_wrong_steps() -> None:
    sequence = SEQUENCES['room-00']
    truth = np.array([frame(k, 0.1 * k).T_world_sensor for k in range(6)])
    estimate = truth.copy()
    estimate[3, 1, 3] += 0.5
    rows: list[dict[str, Any]] = [{'source': 'kiss_icp'} for _ in truth]
    scores = suite_run._scores(estimate, truth, rows, sequence)
    assert [r.get('step_right') for r in rows] == [None, True, True, False, False, True]
    assert [r.get('pose_right') for r in rows] == [None, True, True, False, True, True]
    assert scores['right_share'] == pytest.approx(3 / 5)
    assert scores['path_m'] == pytest.approx(0.5)


def test_baseline_is_compared_at_the_instant_that_suits_it() -> None:
    frames = [frame(k, 0.1 * k**1.5) for k in range(6)]
    times = np.linspace(0.0, 0.08, 400)
    frames = [replace(f, scan=replace(f.scan, times=times)) for f in frames]
    truth = np.array([f.T_world_sensor for f in frames])
    stamps = np.array([f.scan.stamp * 1e-9 for f in frames])
    at_end = suite_run._at(truth, stamps, 0.08)
    moved, instant = suite_run._kindest(at_end, truth, frames)
    assert instant == 1.0
    np.testing.assert_allclose(moved, at_end)


def cell(name: str, method: str, ate_m: float, stride: int = 1, wrong: int = 0) -> dict[str, Any]:
    sequence = SEQUENCES[name]
    rows = [
        {
            'source': 'kiss_icp',
            'reason': 'ok',
            'confidence': 0.9,
            'points': 5,
            'cpu_ms': 10.0,
            'step_m': 0.01,
            'step_deg': 0.1,
            'step_right': k > wrong,
            'pose_right': k > wrong,
            'mask': [8, 2, 2, 88],
        }
        for k in range(11)
    ]
    scores = {
        'frames': 11,
        'path_m': 10.0,
        'ate_m': ate_m,
        'ate_percent': 10.0 * ate_m,
        'step_median_mm': 1.0,
        'right_share': 1.0 - wrong / 10,
        'lost': 0,
    }
    return {
        'version': 1,
        'sequence': asdict(sequence),
        'method': method,
        'stride': stride,
        'scores': scores,
        'frames': rows,
        'provenance': {},
    }


def test_table_has_every_row_with_figure_number_and_verdict() -> None:
    cells = [
        cell('room-02', 'ours', 0.02),
        cell('room-02', 'kiss-icp', 0.2),
        cell('room-02', 'genz-icp', 0.1),
        cell('room-00', 'ours', 0.3),
        cell('room-00', 'ours', 0.3, stride=5, wrong=2),
        cell('dev-room-501', 'ours', 9.0),
    ]
    table = suite_table.build(cells)
    rows = {r['name']: r for r in table['rows']}

    def row(start: str) -> dict[str, Any]:
        return next(r for name, r in rows.items() if name.startswith(start))

    ratio = row('ATE against the better of kiss-icp')
    assert ratio['figure'] == pytest.approx(0.2)
    assert (ratio['n'], ratio['verdict']) == (1, 'pass')
    still = row('ATE in percent of the path, rooms static')
    assert (still['figure'], still['verdict']) == (pytest.approx(3.0), 'below floor')
    fives = row('wrong steps at stride 5')
    assert fives['figure'] == pytest.approx(0.2)
    assert fives['verdict'] == 'below floor'
    above = row('wrong poses above the gate')
    assert above['figure'] == pytest.approx(2 / 30)
    assert row('wrong pairs of lidar_kitti07')['verdict'] == 'not run'
    iou = row('1 - IoU')
    assert iou['figure'] == pytest.approx(1.0 - 8 / 12)
    assert any('room-02: ' in m for m in table['missing'])
    text = suite_table.markdown(table)
    assert text.count('\n| room-0') == 5
    assert 'dev-room' not in text
    assert 'Not run: room-00: ' in text


def loop(steps: int, first: float, last: float) -> dict[str, Any]:
    return {'steps': steps, 'resident_mb': {'100': first, str(steps - 1): last}}


def test_the_table_has_the_memory_of_long_loops(tmp_path: Path) -> None:
    def row(memory: dict[str, Any], method: str = 'ours') -> tuple[Any, ...]:
        table = suite_table.build([cell('room-02', method, 0.02)], method, memory)
        found = next(r for r in table['rows'] if r['name'].startswith('growth of resident memory'))
        missing = any(m.startswith('memory: ') for m in table['missing'])
        return found['figure'], found['n'], found['verdict'], missing

    short, long = loop(2_000, 600.0, 700.0), loop(10_000, 700.0, 740.5)
    assert suite_memory.read(tmp_path) == {}
    assert row({}) == row({'a': short}) == (None, 0, 'not run', True)
    (tmp_path / 'memory.json').write_text(json.dumps({'a': short, 'b': long}), 'utf-8')
    assert row(suite_memory.read(tmp_path)) == (40.5, 1, 'pass', False)
    assert row({'b': long, 'c': loop(20_000, 700.0, 751.0)}) == (51.0, 2, 'below floor', False)
    assert row({'b': long}, 'ours-no-mask')[2] == 'not run'


@pytest.mark.parametrize(
    'text',
    ['{', '[1]', '{"a": {"steps": 7}}', '{"a": 3}', '{"a": {"steps": 7, "resident_mb": 1}}'],
)
def test_figures_of_memory_that_are_something_else_are_an_error(tmp_path: Path, text: str) -> None:
    (tmp_path / 'memory.json').write_text(text, 'utf-8')
    with pytest.raises(FileFormatError, match=r'memory\.json: expected .* remove it and measure'):
        suite_memory.read(tmp_path)


def test_figures_of_memory_are_looked_at_before_cells_are_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(suite_run, 'run_cell', lambda *_: pytest.fail('a cell was run'))
    (tmp_path / 'memory.json').write_text('{', 'utf-8')
    assert main(['replay', '--suite', 'rooms', '--frames', '2', '--out', str(tmp_path)]) == 2
    assert 'memory.json: expected' in capsys.readouterr().err


def test_plots_show_each_suite_that_was_run(tmp_path: Path) -> None:
    pytest.importorskip('matplotlib')
    cells = [cell('room-02', 'ours', 0.02, wrong=3), cell('room-02', 'kiss-icp', 0.2)]
    line = [[0.1 * k, 0.0, 0.01 * k] for k in range(11)]
    for one in cells:
        one['trajectory'] = {'truth': line, 'estimate': line}
    written = suite_plots.write_plots(cells, tmp_path / 'plots')
    assert [p.name for p in written] == ['rooms_trajectories.png', 'rooms_confidence.png']
    assert all(p.read_bytes().startswith(b'\x89PNG') for p in written)


def evidences(name: str, seed: int) -> suite_fit.EvidenceSamples:
    rng = np.random.default_rng(seed)
    features = rng.uniform(0.0, 1.0, (400, len(calibration.EVIDENCE)))
    right = rng.uniform(size=400) < 1.0 / (1.0 + np.exp(-(8.0 * features[:, 0] - 4.0)))
    return suite_fit.EvidenceSamples(name, features, right, rng.chisquare(6, 300) * 2.0)


def test_fit_finds_the_weights_and_the_scale(tmp_path: Path) -> None:
    found, quality = suite_fit.fit([evidences('dev-room-a', 1), evidences('dev-street-b', 2)])
    assert found.evidence.weights['consistent'] == pytest.approx(8.0, abs=1.5)
    assert set(found.covariance_scale) == {'depth', 'lidar'}
    assert min(found.covariance_scale.values()) == pytest.approx(2.0, rel=0.2)
    assert quality['ece_left_out'] < 0.06
    path = tmp_path / 'c.json'
    path.write_text(json.dumps(found.to_dict()))
    assert calibration.read(path) == found


def test_fit_of_one_kind_only_is_an_error() -> None:
    one = replace(evidences('dev-room-a', 1), right=np.ones(400, np.bool_))
    with pytest.raises(HybridRegError, match='nothing to fit: 400 of 400 poses are right'):
        suite_fit.fit([one])


@pytest.mark.parametrize(
    ('text', 'match'),
    [
        ('{}', 'cannot read the calibration'),
        ('no json', 'cannot read the calibration'),
        (WITH % ('{"x": 1}', '{}'), 'expected weights of consistent'),
        (
            (WITH % (WEIGHTS, '{}')).replace('runner_up', 'runners_up'),
            'expected weights of evident',
        ),
        (WITH % (WEIGHTS, '{"depth": 1}'), 'scales of depth, lidar, found depth'),
        (WITH % (WEIGHTS, '{"depth": 1, "lidar": -1}'), 'positive covariance scales'),
    ],
)
def test_bad_calibration_is_an_error(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / 'c.json'
    path.write_text(text)
    with pytest.raises(ConfigError, match=match):
        calibration.read(path)


def test_predictions_are_off_only_in_jolted_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    class Noticed(HybridOdometry):
        def __init__(self, *args: Any, **settings: Any) -> None:
            super().__init__(*args, **settings)
            made.append((self._motion, self.config.gate.sure))

    monkeypatch.setattr(suite_fit, 'HybridOdometry', Noticed)
    sequence = chosen('dev', ['dev-room-501'])[0]
    for jolted in (True, False):
        suite_fit.gather(sequence, [], 2, OdometryConfig(), jolted)
    (off, always), (plain, usual) = made
    assert isinstance(off, suite_fit.Jolted)
    assert not isinstance(plain, suite_fit.Jolted)
    assert always == 1.0 > usual


def test_distinct_leaves_repetitions_out() -> None:
    from hybridreg_ros.odometry.registration.alignment import Fit
    from hybridreg_ros.odometry.result import Reason, Source
    from hybridreg_ros.odometry.selection.candidates import Candidate
    from hybridreg_ros.odometry.selection.pose_confidence import PoseEvidence

    def at(x: float) -> Candidate:
        pose = se3.transform(np.eye(3), np.array([x, 0.0, 0.0]))
        fit = Fit(pose, np.eye(6), 1.0, 1e-6 * np.eye(6))
        return Candidate(fit, Source.KISS_ICP, Reason.OK, PoseEvidence(1.0, 1.0, 1.0), pose)

    assert len(suite_fit._distinct([at(0.0), at(0.002), at(0.5), at(0.501)])) == 2


def test_suite_command_keeps_cells_and_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'suite'
    command = [
        'replay',
        '--suite',
        'rooms',
        '--sequences',
        'room-00',
        '--frames',
        '4',
        '--strides',
        '1',
        '2',
        '--out',
        str(out),
        '--methods',
    ]
    assert main([*command, 'ours-no-network']) == 0
    cells = sorted((out / 'cells').iterdir())
    assert [p.name for p in cells] == [
        'room-00__ours-no-network__1.json',
        'room-00__ours-no-network__2.json',
    ]
    made = json.loads(cells[0].read_text())
    assert made['scores']['frames'] == 4
    assert made['frames'][1]['pose_right'] is True
    assert made['fingerprint']['config']
    before = [p.stat().st_mtime_ns for p in cells]
    assert main([*command, 'ours-no-network', 'small-gicp']) == 0
    assert [p.stat().st_mtime_ns for p in cells] == before
    assert len(list((out / 'cells').iterdir())) == 4
    made['fingerprint']['config'] = 'another'
    cells[0].write_text(json.dumps(made))
    assert main([*command, 'ours-no-network']) == 0
    assert json.loads(cells[0].read_text())['fingerprint']['config'] != 'another'
    assert 'room-00: 20 of 24 cells' in capsys.readouterr().out
    assert json.loads((out / 'suite.json').read_text())['rows']


@pytest.mark.parametrize(
    ('arguments', 'match'),
    [
        (['--suite', 'rooms'], '--suite needs a folder for its results'),
        (['x.mcap', '--suite', 'rooms', '--out', 'o'], '--suite takes no bags'),
        (['--suite', 'rooms', '--out', 'o', '--methods', 'magic'], "found 'magic'"),
        (['--suite', 'rooms', '--out', 'o', '--fit', 'f'], '--fit needs --suite dev'),
        (
            ['--suite', 'all', '--out', 'o', '--fit-confidence', 'f'],
            '--fit-confidence needs --suite dev',
        ),
        (['--suite', 'dev', '--out', 'o', '--fit', 'f', '--fit-confidence', 'f'], 'not allowed'),
        ([], 'no bag given'),
    ],
)
def test_suite_command_refuses_what_makes_no_sense(
    arguments: list[str], match: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['replay', *arguments]) == 2
    assert match in capsys.readouterr().err


def test_every_method_has_a_front_end() -> None:
    for method in METHODS:
        if method not in ('genz-icp',):
            assert suite_run.front_end(method, OdometryConfig(), None) is not None


@pytest.mark.parametrize(
    ('pipeline', 'module'), [(GenzIcp, 'genz_icp'), (GicpToKeyframe, 'small_gicp')]
)
def test_a_missing_baseline_names_the_extra(pipeline, module, monkeypatch) -> None:
    for name in [m for m in sys.modules if m.split('.')[0] == module] + [module]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(DependencyError, match=r"pip install 'hybridreg_ros\[bench\]'"):
        pipeline(0.1, 10.0, 0.1)


def _samples(name: str, rng: np.random.Generator, count: int) -> suite_confidence.ReportedSamples:
    """Poses that are wrong where the evidence is weak or a runner-up strong."""
    features = rng.uniform(0.0, 1.0, (count, len(calibration.REPORTED)))
    features[:, 0] = rng.uniform(-1.0, 6.0, count)
    score = features[:, 0] - 4.0 * features[:, -1]
    right = rng.uniform(size=count) < 1.0 / (1.0 + np.exp(-score))
    return suite_confidence.ReportedSamples(name, features, right)


def test_the_confidence_learns_what_speaks_against_a_pose(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    parts = [_samples(f'dev-room-{k}', rng, 2000) for k in range(4)]
    found, quality = suite_confidence.fit(parts)
    weights = found.confidence.weights
    assert weights['evident'] == pytest.approx(1.0, abs=0.15)
    assert weights['runner_up'] == pytest.approx(-4.0, abs=0.5)
    assert max(abs(weights[k]) for k in ('unmatched', 'disagreement', 'innovation')) < 0.4
    assert quality['ece_left_out'] < 0.03
    told, shown = quality['above_gate_left_out'], quality['above_gate_by_evidence']
    assert told['wrong'] / told['poses'] < 0.7 * shown['wrong'] / shown['poses']
    assert found.evidence == calibration.packaged().evidence
    file = tmp_path / 'calibration.json'
    file.write_text(json.dumps(found.to_dict()))
    assert calibration.read(file).confidence == found.confidence
    again = suite_confidence.ReportedSamples.from_dict(json.loads(json.dumps(parts[0].to_dict())))
    np.testing.assert_array_equal(again.features, parts[0].features)
    right = replace(parts[0], right=np.ones(2000, np.bool_))
    with pytest.raises(HybridRegError, match='nothing to fit: 2000 of 2000'):
        suite_confidence.fit([right])


def test_confidences_are_gathered_as_they_are_reported(tmp_path: Path) -> None:
    sequence = replace(chosen('dev', ['dev-room-501'])[0], frames=5)
    frames = suite_data.load(sequence, tmp_path, tmp_path)
    found = suite_confidence.gather(sequence, frames, 1, OdometryConfig(), model=None)
    assert found.features.shape == (4, len(calibration.REPORTED))
    assert found.right.all()
    few = Scan(frames[2].scan.points[:20], stamp=frames[2].scan.stamp, frame_id='sensor')
    covered = [*frames[:2], replace(frames[2], scan=few), *frames[3:]]
    assert len(suite_confidence.gather(sequence, covered, 1, OdometryConfig(), None).right) == 3

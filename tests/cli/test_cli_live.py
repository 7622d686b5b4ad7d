# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg replay --live` and `demo` through the real node over DDS."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_bags import write_room_bag

from hybridreg_ros.cli.main import main
from hybridreg_ros.replay.bag_reader import open_bag

if TYPE_CHECKING:
    from pathlib import Path

pytest.importorskip('rclpy')
pytestmark = pytest.mark.ros
KISS = ['--registrar', 'kiss-icp']


def test_live_equals_offline(room_bag: Path, tmp_path: Path) -> None:
    offline, live = tmp_path / 'offline', tmp_path / 'live'
    assert main(['replay', str(room_bag), '--out', str(offline), *KISS]) == 0
    assert main(['replay', str(room_bag), '--out', str(live), *KISS, '--live']) == 0
    first, second = (np.loadtxt(folder / 'odometry.tum') for folder in (offline, live))
    assert first.shape == second.shape == (12, 8)
    np.testing.assert_allclose(first, second, atol=1e-6)
    a, b = (json.loads((folder / 'metrics.json').read_text()) for folder in (offline, live))
    assert b['live'] is True
    assert b['transport']['sent'] == b['transport']['received_odom'] == 12
    assert b['drops'] == []
    for count in ('tp', 'fp'):  # in the first scans the node publishes no others
        assert a['mask']['counts'][count] == b['mask']['counts'][count] > 0
    for ours, theirs in zip(a['per_frame'], b['per_frame'], strict=True):
        for name in ('stamp', 'source', 'reason', 'dynamic'):
            assert ours[name] == theirs[name]
        assert theirs['confidence'] == pytest.approx(ours['confidence'], abs=1e-6)
        assert theirs['total_ms'] > 0.0
    assert a['sources'] == b['sources']
    assert a['reasons'] == b['reasons']
    assert b['trajectory']['step_mean_mm'] == pytest.approx(a['trajectory']['step_mean_mm'], 1e-4)
    with open_bag(offline / 'dynamic.mcap') as x, open_bag(live / 'dynamic.mcap') as y:
        assert x.topics == y.topics
        for topic in ('/hybridreg/dynamic_points', '/hybridreg/static_points'):
            ours = [m.data.tobytes() for m in map(x.decode, x.messages([topic]))]
            theirs = [m.data.tobytes() for m in map(y.decode, y.messages([topic]))]
            # As static the node publishes nothing in the first quarter of a second; the file of
            # a replay keeps all points.
            assert ours[3:] == theirs[3:]
        assert theirs[:3] == [b''] * 3
    assert 'through the node, live' in (live / 'report.html').read_text('utf-8')


def test_live_bad_bag_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_room_bag(tmp_path / 'bare.mcap', 1, topics=())
    arguments = ['replay', str(tmp_path / 'bare.mcap'), '--out', str(tmp_path / 'o'), '--live']
    assert main([*arguments, *KISS]) == 2
    assert 'has no PointCloud2 topic' in capsys.readouterr().err


@pytest.mark.slow
def test_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / 'demo'
    assert main(['demo', '--out', str(out), '--frames', '8', '--json', str(out / 'd.json')]) == 0
    table = capsys.readouterr().out
    assert 'hybridreg' in table
    assert 'kiss-icp alone' in table
    result = json.loads((out / 'd.json').read_text())
    assert result['transport']['received_odom'] == 8
    assert result['transport']['received_dynamic'] == 8
    assert result['mask'] is not None
    assert result['beside']['kiss-icp alone']['matched'] == 8
    page = (out / 'report.html').read_text('utf-8')
    assert 'kiss-icp alone' in page

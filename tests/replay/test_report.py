# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Charts, pictures, tables and the live log: parts of the report looked at closely."""

from __future__ import annotations

import base64
import dataclasses
import doctest
import io
import json
import re
import threading
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image
from tiny_bags import PERIOD, START, sensor_pose

from hybridreg_ros.core import se3
from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.core.quaternion import to_quaternion
from hybridreg_ros.metrics.mask import MaskCounts
from hybridreg_ros.metrics.trajectory import Trajectory
from hybridreg_ros.replay import outputs
from hybridreg_ros.replay.bag_reader import open_bag
from hybridreg_ros.replay.frame_errors import frame_errors
from hybridreg_ros.replay.live_log import LiveRecorder
from hybridreg_ros.replay.page import charts, pictures, report, scene, story, tables
from hybridreg_ros.replay.runner import Drop, FrameLog, ReplayLog

if TYPE_CHECKING:
    from pathlib import Path


def test_doctests() -> None:
    assert doctest.testmod(charts).failed == 0


def points_of(svg: str, kind: str = 'line c0') -> list[tuple[float, float]]:
    """Pixels of a drawn line."""
    match = re.search(rf'<path class="{kind}" d="([^"]+)"', svg)
    assert match
    return [(float(x), float(y)) for x, y in re.findall(r'[ML]([-\d.]+) ([-\d.]+)', match[1])]


def test_time_chart_draws_what_it_is_given() -> None:
    x = np.arange(5.0)
    y = np.array([0.0, 1.0, np.nan, 3.0, 4.0])
    series = [charts.Series('a <b>', x, y), charts.Series('b', x, 2 * y, 1, dashed=True)]
    html = charts.time_chart(series, 'm', 'say "it"', [charts.Band(1.0, 2.0, 'lost')])
    svg = html[: html.index('</svg>') + 6]
    ElementTree.fromstring(svg)
    pixels = points_of(svg)
    assert len(pixels) == 4, 'NaN is a gap'
    assert svg.count('M') >= 2
    assert np.allclose(np.diff([p[0] for p in pixels[:2]]), np.diff([p[0] for p in pixels[2:]]))
    heights = [p[1] for p in pixels]
    assert heights == sorted(heights, reverse=True), 'larger values must stand higher'
    assert 'a &lt;b&gt;' in html
    assert 'class="band lost"' in svg


def test_plan_chart_keeps_the_aspect() -> None:
    t = np.linspace(0, 2 * np.pi, 100)
    svg = charts.plan_chart([charts.Series('circle', np.cos(t), np.sin(t))], 'x', 'y', 'c')
    pixels = np.array(points_of(svg))
    assert np.ptp(pixels[:, 0]) == pytest.approx(np.ptp(pixels[:, 1]), rel=0.02)


@pytest.mark.parametrize('values', [[], [1.0], [np.nan, np.nan], [5.0, 5.0]])
def test_charts_of_next_to_nothing(values: list[float]) -> None:
    y = np.array(values, dtype=np.float64)
    svg = charts.time_chart([charts.Series('s', np.arange(float(len(y))), y)], 'm', 'l')
    assert 'nan' not in svg
    plan = charts.plan_chart([charts.Series('s', y, y)], 'x', 'y', 'l')
    assert 'inf' not in plan


def wall(optical: bool) -> np.ndarray[Any, np.dtype[np.float32]]:
    """A wall 3 m ahead with a box 1 m ahead at the upper right."""
    side, up = np.meshgrid(np.linspace(-1.5, 1.5, 120), np.linspace(-1, 1, 80))
    ahead = np.full(side.shape, 3.0)
    box = (side > 0.5) & (up > 0.3)
    ahead[box] = 1.0
    side, up = side * ahead / 3, up * ahead / 3
    axes = (side, -up, ahead) if optical else (ahead, -side, up)
    return np.stack([a.ravel() for a in axes], axis=1).astype(np.float32)


@pytest.mark.parametrize('optical', [True, False])
@pytest.mark.parametrize('labelled', [True, False])
def test_picture_shows_masks_where_they_are(optical: bool, labelled: bool) -> None:
    points = wall(optical)
    moving = np.linalg.norm(points, axis=1) < 1.5
    truth = np.zeros_like(moving)
    truth[:2000] = True
    view = pictures.FrameView(0, points, moving, truth if labelled else None)
    image = np.array(Image.open(io.BytesIO(pictures.render(view))))
    where = {
        colour: np.argwhere((image == colour).all(axis=2))
        for colour in (pictures.MOVING, pictures.FALSE_ALARM, pictures.MISSED)
    }
    box = where[pictures.FALSE_ALARM if labelled else pictures.MOVING]
    assert len(box) > 500
    assert box[:, 0].max() < 0.5 * image.shape[0], 'the box is in the upper half'
    assert box[:, 1].min() > 0.5 * image.shape[1], 'and on the right'
    assert bool(len(where[pictures.MISSED])) == labelled
    background = (image == pictures.BACKGROUND).all(axis=2).mean()
    assert background < 0.05, 'gaps between the points of a grid'


def test_picture_of_nothing() -> None:
    view = pictures.FrameView(0, np.zeros((0, 3), np.float32), np.zeros(0, bool), None)
    assert Image.open(io.BytesIO(pictures.render(view))).size[0] == pictures.WIDTH


def test_album_keeps_few_frames_and_the_best() -> None:
    album = pictures.Album(100, wanted=3)
    for i in range(100):
        moving = np.zeros(10, bool)
        moving[: 5 if i == 60 else 1] = True
        album.offer(pictures.FrameView(i, np.zeros((10, 3), np.float32), moving, None))
    assert [v.stamp for v in album.views()] == [24, 49, 60, 74]


def run_log(n: int = 6) -> ReplayLog:
    frames = [
        FrameLog(
            START + i * PERIOD,
            sensor_pose(i),
            source='kiss_icp' if i < 3 else 'hybridreg',
            reason='ok',
            confidence=0.1 * i,
            points=100,
            dynamic=10,
            seconds={'match': 0.01, 'total': 0.02},
            mask=MaskCounts(5, 5, 5, 85),
        )
        for i in range(n)
    ]
    return ReplayLog(frames, [Drop(START, 'a <bad> cloud')])


def test_report_escapes_and_tells_everything(tmp_path: Path) -> None:
    log = run_log()
    truth = log.trajectory()
    run = report.ReportRun('ours <x>', log, outputs.score_log(log, truth), truth, (), {'a': 1})
    report.write_report(tmp_path / 'r.html', 'Title & more', 'sub <title>', [run])
    page = (tmp_path / 'r.html').read_text('utf-8')
    assert '<bad>' not in page
    assert 'a &lt;bad&gt; cloud' in page
    assert 'Title &amp; more' in page
    assert 'class="band kiss_icp"' in page
    assert 'class="band hybridreg"' in page
    match = re.search(r'id="frames">(.*?)</script>', page)
    assert match
    rows = json.loads(match[1])
    assert [r['s'] for r in rows] == ['kiss-icp'] * 3 + ['network'] * 3
    assert rows[0]['e'] is None
    assert rows[1]['ep'] == pytest.approx(0.0, abs=1e-6)
    assert rows[1]['e'] == pytest.approx(0.0, abs=1e-6)
    assert '>0.333<' in page, 'IoU 5 / 15'


@pytest.mark.parametrize('n', [0, 1])
def test_report_of_next_to_nothing(tmp_path: Path, n: int) -> None:
    log = run_log(n)
    scores = outputs.score_log(log, Trajectory(np.array([START]), sensor_pose(0)[None]))
    assert f'{n} poses are too few' in scores.note
    report.write_report(tmp_path / 'r.html', 't', 's', [report.ReportRun('r', log, scores)])
    assert 'No trajectory score' in (tmp_path / 'r.html').read_text('utf-8')


def steady_log(n: int = 20, push: int | None = None) -> ReplayLog:
    """A straight walk; frame `push` stands 40 mm beside it."""
    poses = [se3.exp(np.array([0.1 * i, 0.0, 0.0, 0.0, 0.0, 0.0])) for i in range(n)]
    if push is not None:
        poses[push][1, 3] += 0.04
    return ReplayLog(
        [
            FrameLog(START + i * PERIOD, T, 'hybridreg', 'ok', 0.99, seconds={'total': 0.05})
            for i, T in enumerate(poses)
        ]
    )


def test_story_without_truth_names_the_jump() -> None:
    scores = outputs.Scores()
    text = ' '.join(story.sentences(steady_log(push=12), scores, START))
    assert '20 clouds in 1.9 s; the sensor went 1.9' in text
    assert 'the path ends 1.90 m from where it began' in text
    assert 'the largest by 40.0 mm (at 1.20 s, reported with a confidence of 0.99)' in text
    assert 'A cloud took 50 ms (median), faster than they came (every 100 ms).' in text
    assert story.worst(steady_log(push=12), None)[0] == (12, 'jump of 40.0 mm')
    calm = ' '.join(story.sentences(steady_log(), scores, START))
    assert 'unlike' not in calm
    assert 'No pose was lost, and every cloud was used.' in calm


def test_story_with_truth_compares_and_finds_the_worst_frame() -> None:
    truth, log = steady_log().trajectory(), steady_log(push=12)
    scores = outputs.score_log(log, truth)
    other = outputs.score_log(steady_log(push=5), truth)
    text = ' '.join(story.sentences(log, scores, START, [('kiss-icp alone', other)]))
    assert re.search(r'The path is \d+\.\d mm off the truth', text)
    assert 'kiss-icp alone on the same clouds: ' in text
    errors = frame_errors(log, truth)
    assert {row for row, _ in story.worst(log, errors)[:2]} == {12, 13}
    back = se3.apply(errors.T_odom_world, errors.truth_path)
    np.testing.assert_allclose(back, [[0.1 * i, 0.0, 0.0] for i in range(20)], atol=0.02)


def test_story_says_when_what_went_wrong() -> None:
    log = steady_log()
    for k in (3, 4, 5, 9):
        log.frames[k] = dataclasses.replace(log.frames[k], source='lost', confidence=0.0)
    log.drops.append(Drop(START, 'cut'))
    log.interrupted = 'interrupted (Ctrl-C)'
    text = ' '.join(story.sentences(log, outputs.Scores(), START))
    assert 'The pose was lost in 4 frames: 0.3 to 0.5 s, 0.9 s.' in text
    assert '1 clouds were not used' in text
    assert 'This run ended early: interrupted (Ctrl-C).' in text
    assert story.worst(log, None)[0] == (3, 'lost')


def test_scene_is_bounded_and_stands_where_it_was() -> None:
    rng = np.random.default_rng(1)
    sink = scene.SceneSink()
    wall = np.stack([rng.random(40_000) * 400, np.zeros(40_000), rng.random(40_000) * 400], axis=1)
    for k in range(400):
        pose = se3.exp(np.array([0.5 * k, 0.0, 0.0, 0.0, 0.0, 0.3]))
        seen = se3.apply(se3.inverse(pose), wall + rng.normal(0, 0.001, wall.shape))
        moving = np.zeros(len(seen), bool)
        moving[:2000] = True
        sink.offer(START + k * PERIOD, pose, seen.astype(np.float32), moving)
    made = sink.scene()
    assert len(made.still) <= scene.STILL_POINTS
    assert sum(map(len, made.moving.values())) <= scene.MOVING_POINTS
    assert 100 <= len(made.moving) < 400
    assert np.abs(made.still[:, 1]).max() < 0.01
    assert not made.optical
    page = scene.for_page(made, START)
    low, steps = page['low'], np.frombuffer(base64.b64decode(page['still']), '<u2').reshape(-1, 3)
    np.testing.assert_allclose(low + page['step'] * steps, made.still, atol=0.6 * page['step'])
    assert [m['t'] for m in page['moving']] == sorted(m['t'] for m in page['moving'])


def test_scene_of_a_camera_stands_upright() -> None:
    made = scene.SceneSink()
    made.offer(START, np.eye(4), wall(optical=True), np.zeros(len(wall(True)), bool))
    up = made.scene().upright(np.array([[0.0, -1.0, 3.0]]))
    np.testing.assert_allclose(up, [[3.0, 0.0, 1.0]])


def test_text_table_is_aligned() -> None:
    log = run_log()
    rows = tables.score_rows([('a', log, outputs.score_log(log, None))])
    lines = tables.text_table(rows).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert lines[0].startswith('run')
    assert lines[2].split()[1] == '6'


def test_plain_makes_strict_json() -> None:
    value = {'a': float('nan'), 'b': (1, np.float32(2)), 'c': np.eye(1), 'd': MaskCounts(1)}
    text = json.dumps(outputs.plain(value), allow_nan=False)
    assert json.loads(text) == {
        'a': None,
        'b': [1, 2.0],
        'c': [[1.0]],
        'd': {'tp': 1, 'fp': 0, 'fn': 0, 'tn': 0},
    }


def message(stamp: int, **fields: Any) -> SimpleNamespace:
    sec, nanosec = divmod(stamp, 10**9)
    header = SimpleNamespace(
        stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id=fields.pop('frame_id', 'lidar')
    )
    return SimpleNamespace(header=header, **fields)


def odometry(stamp: int, pose: np.ndarray[Any, np.dtype[np.float64]], variance: float) -> Any:
    x, y, z, w = to_quaternion(pose[:3, :3])
    vector = SimpleNamespace(x=1.0, y=0.0, z=0.0)
    return message(
        stamp,
        frame_id='odom',
        child_frame_id='lidar',
        pose=SimpleNamespace(
            pose=SimpleNamespace(
                position=SimpleNamespace(x=pose[0, 3], y=pose[1, 3], z=pose[2, 3]),
                orientation=SimpleNamespace(x=x, y=y, z=z, w=w),
            ),
            covariance=np.full(36, variance),
        ),
        twist=SimpleNamespace(
            twist=SimpleNamespace(linear=vector, angular=vector), covariance=np.zeros(36)
        ),
    )


def labelled_cloud(stamp: int, labels: list[int]) -> Any:
    cloud = from_arrays(
        np.ones((len(labels), 3), np.float32), {'label': np.array(labels, np.uint8)}
    )
    return message(stamp, **vars(cloud))


def about_frame(stamp: int, source: str) -> SimpleNamespace:
    """A report of the node about one frame."""
    values = {'source': source, 'reason': 'ok', 'confidence': '0.75', 'total_ms': '12.5'}
    pairs = [SimpleNamespace(key=k, value=v) for k, v in values.items()]
    return message(stamp, status=[SimpleNamespace(values=pairs)])


def test_live_recorder_joins_messages_of_any_order_and_thread(tmp_path: Path) -> None:
    files = outputs.OutputFiles(tmp_path)
    recorder = LiveRecorder(files, 4)
    calls = []
    for i in range(4):
        stamp = START + i * PERIOD
        variance = 9999.0 if i == 3 else 0.1
        calls += [
            (recorder.on_static, labelled_cloud(stamp, [0, 0, 1])),
            (recorder.on_odom, odometry(stamp, sensor_pose(i), variance)),
        ]
        if i != 2:
            calls.append((recorder.on_dynamic, labelled_cloud(stamp, [1, 0])))
        if i in {1, 3}:
            calls.append((recorder.on_frame, about_frame(stamp, 'kiss_icp' if i == 1 else 'lost')))
    threads = [
        threading.Thread(target=lambda part: [f(m) for f, m in part], args=(calls[k::3],))
        for k in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    recorder.close()
    files.close()
    frames = recorder.log.frames
    assert [f.stamp for f in frames] == [START + i * PERIOD for i in range(4)]
    assert [f.source for f in frames] == ['', 'kiss_icp', '', 'lost']
    assert [f.reason for f in frames] == ['', 'ok', '', 'ok']
    assert (frames[1].confidence, frames[1].seconds) == (0.75, {'total': 0.0125})
    assert frames[0].mask == MaskCounts(tp=1, fp=1, fn=1, tn=2)
    assert frames[2].mask is None, 'its dynamic cloud never came'
    for i, frame in enumerate(frames):
        np.testing.assert_allclose(frame.pose, sensor_pose(i), atol=1e-12)
    assert len((tmp_path / 'odometry.tum').read_text().splitlines()) == 4
    with open_bag(tmp_path / 'dynamic.mcap') as bag:
        counts = {t.name: t.messages for t in bag.topics.values()}
    assert counts == {
        '/hybridreg/odom': 4,
        '/tf': 4,
        '/hybridreg/dynamic_points': 3,
        '/hybridreg/static_points': 4,
    }


@pytest.mark.parametrize('name', ['kiss-icp', 'genz-icp', 'small-gicp'])
def test_baseline_alone_moves_with_the_sensor(room_bag: Path, name: str) -> None:
    from hybridreg_ros.benchmark.baseline import Alone
    from hybridreg_ros.replay import runner

    if name == 'genz-icp':
        pytest.importorskip('genz_icp')
    with open_bag(room_bag) as bag:
        log = runner.run(bag.frames(), Alone(name))
        truth = bag.ground_truth()
    assert truth is not None
    assert len(log.frames) == 12
    moved = se3.inverse(log.frames[0].pose) @ log.frames[-1].pose
    true_move = se3.inverse(truth.poses[0]) @ truth.poses[-1]
    assert np.linalg.norm(moved[:3, 3] - true_move[:3, 3]) < 0.1


def test_unknown_baseline_is_an_error() -> None:
    from hybridreg_ros.benchmark.baseline import Alone
    from hybridreg_ros.core.errors import ConfigError

    with pytest.raises(ConfigError, match='baseline: expected kiss-icp, genz-icp or small-gicp'):
        Alone('magic')

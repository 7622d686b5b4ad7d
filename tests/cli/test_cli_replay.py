# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg replay` from the outside: results, bad bags, bad settings, Ctrl-C."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from tiny_bags import PERIOD, START, cloud_bytes, room_cloud, sensor_pose, write_room_bag

from hybridreg_ros.cli.main import main
from hybridreg_ros.core.pointcloud2 import CloudData, from_arrays
from hybridreg_ros.core.quaternion import from_quaternion
from hybridreg_ros.metrics.trajectory import Trajectory
from hybridreg_ros.replay.bag_reader import open_bag
from hybridreg_ros.replay.bag_writer import BagWriter
from hybridreg_ros.replay.outputs import OutputFiles
from hybridreg_ros.replay.page.report import plotly_script

KISS = ['--registrar', 'kiss-icp']
OUTPUTS = {
    'odometry.tum',
    'odometry_kitti.txt',
    'truth.tum',
    'truth_kitti.txt',
    'metrics.json',
    'report.html',
    'dynamic.mcap',
    'foxglove.json',
}


def failure(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """The one error line of a command that must fail with exit code 2."""
    capsys.readouterr()
    assert main(arguments) == 2
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if line.startswith('hybridreg')]
    assert 'Traceback' not in error
    assert len(lines) == 1, error
    return lines[0]


@pytest.fixture(scope='module')
def replayed(room_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished replay of the room bag."""
    out = tmp_path_factory.mktemp('replayed') / 'run'
    arguments = ['replay', str(room_bag), '--out', str(out), '--json', str(out / 'j.json'), *KISS]
    assert main(arguments) == 0
    return out


def test_files_and_scores(replayed: Path, room_bag: Path) -> None:
    assert OUTPUTS | {'j.json'} == {p.name for p in replayed.iterdir()}
    metrics = json.loads((replayed / 'metrics.json').read_text())
    assert metrics == json.loads((replayed / 'j.json').read_text())
    assert metrics['frames'] == metrics['accepted'] == 12
    assert metrics['drops'] == []
    assert metrics['sources'] == {'kiss_icp': 11}
    assert metrics['trajectory']['matched'] == 12
    assert metrics['trajectory']['step_mean_mm'] < 30.0
    assert metrics['mask']['counts']['tp'] + metrics['mask']['counts']['fn'] == 12 * 300
    assert len(metrics['per_frame']) == 12
    provenance = metrics['provenance']
    assert provenance['config']['registrar'] == 'kiss-icp'
    assert len(provenance['inputs'][room_bag.name]) == 64
    assert provenance['versions']['numpy'] == np.__version__
    assert {'git_hash', 'python', 'machine'} <= set(provenance)


def test_point_times_are_used_or_it_is_said_why(tmp_path: Path) -> None:
    """A driver's own name, one point of another scan; and a field asked for that is not there."""
    bag_path, result = tmp_path / 'a.mcap', tmp_path / 'r.json'
    rng = np.random.default_rng(3)
    with BagWriter(bag_path) as bag:
        for i in range(4):
            points = rng.uniform(-5, 5, (3000, 3))
            offset = np.linspace(0, 1e8, 3000).astype(np.uint32)
            offset[9] = 3_600_000_000
            cloud = from_arrays(points, {'point_time_offset': offset})
            bag.write_cloud('/points', START + i * PERIOD, 'lidar', cloud)
    arguments = [
        'replay',
        str(bag_path),
        '--out',
        str(tmp_path / 'o'),
        '--json',
        str(result),
        *KISS,
    ]
    assert main(arguments) == 0
    metrics = json.loads(result.read_text())
    assert metrics['point_times'] == {'point_time_offset (ns)': 4}
    assert [row['invalid'] for row in metrics['per_frame']] == [1, 1, 1, 1]
    note = 'field point_time_offset: 1 points left out whose times are not those of the scan'
    assert f'in 4 of 4 clouds: {note}' in metrics['notes']
    assert main([*arguments, '--time-field', 'when', '--overwrite']) == 0
    metrics = json.loads(result.read_text())
    assert metrics['point_times'] == {'none: no field when': 4}
    assert 'in 4 of 4 clouds: no field when in: x, y, z, point_time_offset' in metrics['notes']


def test_no_return_is_in_no_output(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'a.mcap') as bag:
        for i in range(3):
            walls = np.random.default_rng(i).uniform(-5, 5, (3000, 3))
            walls[np.arange(3000), np.arange(3000) % 3] = 5.0
            points = np.concatenate([np.zeros((2000, 3)), walls, np.full((50, 3), 0.2)])
            cloud = from_arrays(points, {'label': (points[:, 0] == 0.2).astype(np.uint8)})
            bag.write_cloud('/points', START + i * PERIOD, 'lidar', cloud)
    out = tmp_path / 'o'
    assert main(['replay', str(tmp_path / 'a.mcap'), '--out', str(out), *KISS]) == 0
    metrics = json.loads((out / 'metrics.json').read_text())
    rows = metrics['per_frame']
    assert [(r['points'], r['near'], r['invalid']) for r in rows] == [(3000, 2050, 0)] * 3
    counts = metrics['mask']['counts']
    assert counts['fp'] + counts['tn'] == 9000
    with open_bag(out / 'dynamic.mcap') as bag:
        topics = ('/hybridreg/static_points', '/hybridreg/dynamic_points')
        parts = [s.points for topic in topics for s in bag.scans(topic)]
    assert sum(map(len, parts)) == 9000
    assert min(np.linalg.norm(p, axis=1).min() for p in parts if len(p)) >= 0.5


def test_odometry_file_is_exact_and_evo_reads_it(replayed: Path, tmp_path: Path) -> None:
    lines = (replayed / 'odometry.tum').read_text().splitlines()
    assert [line.split()[0] for line in lines] == [
        f'{s // 10**9}.{s % 10**9:09d}' for s in range(START, START + 12 * PERIOD, PERIOD)
    ]
    with open_bag(replayed / 'dynamic.mcap') as bag:
        recorded = bag.trajectory('/hybridreg/odom')
    written = np.array([[float(v) for v in line.split()[1:4]] for line in lines])
    assert np.array_equal(written, recorded.poses[:, :3, 3]), 'not the full precision'
    evo_ape = str(Path(sys.executable).parent / 'evo_ape')
    command = [evo_ape, 'tum', 'odometry.tum', 'odometry.tum']
    environment = {**os.environ, 'HOME': str(tmp_path), 'MPLBACKEND': 'Agg'}
    done = subprocess.run(
        command, cwd=replayed, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert 'rmse' in done.stdout


def test_dynamic_bag_keeps_fields_and_all_points(replayed: Path) -> None:
    from rosbags.highlevel import AnyReader

    with AnyReader([replayed / 'dynamic.mcap']) as reader:
        counts = {t: info.msgcount for t, info in reader.topics.items()}
        sizes: dict[int, int] = {}
        for connection, stamp, raw in reader.messages():
            if not connection.topic.endswith('points'):
                continue
            message = reader.deserialize(raw, connection.msgtype)
            names = [f.name for f in message.fields]  # type: ignore[attr-defined]
            assert names == ['x', 'y', 'z', 'intensity', 'label', 'dynamic_probability']
            assert message.header.frame_id == 'lidar'  # type: ignore[attr-defined]
            sizes[stamp] = sizes.get(stamp, 0) + message.width  # type: ignore[attr-defined]
    often = ('odom', 'dynamic_points', 'static_points')
    each = [f'/hybridreg/{name}' for name in often] + ['/tf', '/ground_truth/odom']
    once = {'/tf_static': 2, '/hybridreg/path': 1, '/ground_truth/path': 1}
    assert counts == dict.fromkeys(each, 12) | once
    assert set(sizes.values()) == {3000 + 750 + 300}


def test_viewer_finds_every_cloud_and_path_in_one_frame(replayed: Path) -> None:
    """The transforms lead from `upright` to the sensor, and the truth lies on the path."""
    layout = (replayed / 'foxglove.json').read_text()
    shown = json.loads(layout)['configById']['3D!scene']
    frames: dict[tuple[str, str], list[np.ndarray]] = {}
    with open_bag(replayed / 'dynamic.mcap') as bag:
        assert set(re.findall(r'"(/\w+/\w+)', layout)) <= set(bag.topics)
        for message in bag.messages(['/tf', '/tf_static']):
            for t in bag.decode(message).transforms:
                p = t.transform.translation
                pair = (t.header.frame_id, t.child_frame_id)
                frames.setdefault(pair, []).append(np.array([p.x, p.y, p.z]))
        paths = [bag.decode(m) for m in bag.messages(['/hybridreg/path', '/ground_truth/path'])]
        odometry = bag.trajectory('/hybridreg/odom')
        assert next(bag.messages()).stamp == START, 'paths are there from the first frame on'
    assert set(frames) == {(shown['followTf'], 'odom'), ('odom', 'lidar'), ('odom', 'world')}
    assert np.array_equal(frames['odom', 'lidar'], odometry.poses[:, :3, 3])
    made, truth = (
        np.array([[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in path.poses])
        for path in sorted(paths, key=lambda path: path.header.frame_id)
    )
    assert np.array_equal(made, odometry.poses[:, :3, 3])
    assert made.shape == truth.shape


def test_run_in_rerun(room_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip('rerun')
    arguments = ['replay', str(room_bag), *KISS, '--out', str(tmp_path / 'o'), '--overwrite']
    shown = tmp_path / 'run.rrd'
    assert main([*arguments, '--rerun', str(shown)]) == 0
    rerun = Path(sys.executable).parent / 'rerun'
    printed = subprocess.run(
        [rerun, 'rrd', 'print', '-v', shown], capture_output=True, text=True, check=True
    ).stdout
    for entity in ('sensor/still', 'sensor/moving', 'path', 'truth'):
        assert f'/odom/{entity}' in printed
    assert '/confidence' in printed
    assert main([*arguments, '--rerun', 'run.txt']) == 2
    assert 'expected a file ending in .rrd' in capsys.readouterr().err


def test_run_in_a_rerun_that_runs(room_bag: Path, tmp_path: Path) -> None:
    """Live: a viewer without a window takes what is sent, and saves it."""
    pytest.importorskip('rerun')
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        port = free.getsockname()[1]
    viewer = subprocess.Popen(
        [Path(sys.executable).parent / 'rerun', '--port', str(port), '--save', tmp_path / 'a.rrd'],
        start_new_session=True,
    )
    try:
        address = f'rerun+http://127.0.0.1:{port}/proxy'
        arguments = ['replay', str(room_bag), *KISS, '--out', str(tmp_path / 'o')]
        assert main([*arguments, '--rerun', address]) == 0
        end = time.monotonic() + 60
        saved = tmp_path / 'a.rrd'
        while not (saved.exists() and saved.stat().st_size > 100_000) and time.monotonic() < end:
            time.sleep(0.2)
        assert saved.stat().st_size > 100_000
    finally:
        os.killpg(viewer.pid, signal.SIGTERM)  # `rerun` only starts the viewer
        viewer.wait(30)


@pytest.mark.parametrize('optical', [False, True])
def test_upright_frame_has_the_scene_above_its_floor(tmp_path: Path, optical: bool) -> None:
    files = OutputFiles(tmp_path)
    files.write_odometry(START, ('odom', 'camera'), np.eye(4))
    files.end(Trajectory(np.array([START]), np.eye(4)[None]), optical)
    with open_bag(tmp_path / 'dynamic.mcap') as bag:
        (message,) = bag.messages(['/tf_static'])
        q = bag.decode(message).transforms[0].transform.rotation
    up = [0.0, -1.0, 0.0] if optical else [0.0, 0.0, 1.0]
    np.testing.assert_allclose(from_quaternion(q.x, q.y, q.z, q.w) @ up, [0, 0, 1], atol=1e-12)


def test_score_of_the_outputs_equals_the_metrics(
    replayed: Path, room_bag: Path, tmp_path: Path
) -> None:
    metrics = json.loads((replayed / 'metrics.json').read_text())
    for estimate in ('odometry.tum', 'dynamic.mcap'):
        result = tmp_path / f'{estimate}.json'
        arguments = ['score', str(replayed / estimate), str(room_bag), '--json', str(result)]
        assert main(arguments) == 0
        scores = json.loads(result.read_text())
        for key, value in metrics['trajectory'].items():
            if isinstance(value, float):
                assert scores['trajectory'][key] == pytest.approx(value, rel=1e-6, abs=1e-9)
        if estimate == 'dynamic.mcap':
            assert scores['mask'] == metrics['mask']


def test_report_says_what_counts(replayed: Path) -> None:
    page = (replayed / 'report.html').read_text('utf-8')
    page = page.replace(plotly_script(), '')
    for text in ('Trajectory', 'Error of each frame', 'Frames seen from the sensor', 'ATE'):
        assert text in page
    assert 'http://' not in page.replace('http://www.w3.org/2000/svg', '')
    assert 'https://' not in page


def test_stride_and_max_frames(room_bag: Path, tmp_path: Path) -> None:
    arguments = ['replay', str(room_bag), '--out', str(tmp_path), *KISS, '--stride', '3']
    assert main([*arguments, '--max-frames', '3', '--no-clouds']) == 0
    stamps = [
        row['stamp'] for row in json.loads((tmp_path / 'metrics.json').read_text())['per_frame']
    ]
    assert stamps == [START + i * PERIOD for i in (0, 3, 6)]
    with open_bag(tmp_path / 'dynamic.mcap') as bag:
        assert not any(t.msgtype.endswith('PointCloud2') for t in bag.topics.values())


def test_default_front_end_without_weights_says_so(
    room_bag: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    from hybridreg_ros.core.errors import WeightsError
    from hybridreg_ros.model.checkpoint import packaged_weights

    try:
        packaged_weights()
    except WeightsError:
        pass
    else:
        pytest.skip('weights ship with this version')
    assert main(['replay', str(room_bag), '--out', str(tmp_path), '--max-frames', '2']) == 0
    assert 'no network' in caplog.text
    assert json.loads((tmp_path / 'metrics.json').read_text())['sources'] == {'kiss_icp': 2}


def test_broken_clouds_are_dropped_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = room_cloud(0)
    cut = CloudData(**{**vars(good), 'data': good.data[:99]})
    wrong_step = CloudData(**{**vars(good), 'point_step': 5})
    nan = from_arrays(np.full((500, 3), np.nan, np.float32))
    with BagWriter(tmp_path / 'a.mcap') as bag:
        for i in range(8):
            cloud = {2: cut, 4: wrong_step, 6: nan}.get(i, room_cloud(i))
            bag.write_cloud('/points', START + i * PERIOD, 'lidar', cloud)
            bag.write_odometry(
                '/ground_truth/odom', START + i * PERIOD, ('w', 'l'), sensor_pose(i)
            )
    out = tmp_path / 'out'
    assert main(['replay', str(tmp_path / 'a.mcap'), '--out', str(out), *KISS]) == 0
    assert '2 clouds were not used' in capsys.readouterr().out
    metrics = json.loads((out / 'metrics.json').read_text())
    assert [d['stamp'] for d in metrics['drops']] == [START + 2 * PERIOD, START + 4 * PERIOD]
    assert 'truncated data' in metrics['drops'][0]['reason']
    assert 'wrong point_step' in metrics['drops'][1]['reason']
    assert metrics['frames'] == 6
    assert metrics['per_frame'][4]['invalid'] == 500
    assert 'Clouds not used' in (out / 'report.html').read_text('utf-8')


def test_nothing_usable_is_a_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every cloud broken, or without any return: results are written, the exit code says no."""
    good = room_cloud(0)
    for name, cloud, text in (
        ('cut', CloudData(**{**vars(good), 'data': good.data[:99]}), '3 x truncated data'),
        ('empty', from_arrays(np.zeros((0, 3), np.float32)), '3 x too_few_points'),
        (
            'mm',
            from_arrays(1000.0 * np.random.default_rng(0).normal(size=(3000, 3)) * 5),
            '3 x too_few_points',
        ),
    ):
        with BagWriter(tmp_path / f'{name}.mcap') as bag:
            for i in range(3):
                bag.write_cloud('/points', START + i * PERIOD, 'lidar', cloud)
        out = tmp_path / name
        line = failure(
            capsys, ['replay', str(tmp_path / f'{name}.mcap'), '--out', str(out), *KISS]
        )
        assert f'no cloud gave a pose ({text}' in line
        notes = json.loads((out / 'metrics.json').read_text())['notes']
        assert any('looks like millimetres' in note for note in notes) == (name == 'mm')


def test_clouds_without_stamps_are_replayed_by_log_time(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'a.mcap') as bag:
        for topic, time_ns, raw in cloud_bytes(3, stamped=False):
            bag.write_raw(topic, 'sensor_msgs/msg/PointCloud2', time_ns, raw)
    out = tmp_path / 'o'
    assert main(['replay', str(tmp_path / 'a.mcap'), '--out', str(out), *KISS]) == 0
    metrics = json.loads((out / 'metrics.json').read_text())
    assert metrics['accepted'] == 3
    assert metrics['per_frame'][2]['stamp'] == START + 2 * PERIOD


def test_of_several_topics_one_is_taken_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with BagWriter(tmp_path / 'two.mcap') as bag:
        for topic, frames in {'/front': 2, '/rear': 3, '/top': 3}.items():
            for i in range(frames):
                bag.write_cloud(topic, START + i * PERIOD, 'lidar', room_cloud(i))
    arguments = ['replay', str(tmp_path / 'two.mcap'), '--out', str(tmp_path / 'o'), *KISS]
    assert main(arguments) == 0
    said = capsys.readouterr().err
    assert '3 clouds of /rear' in said
    assert 'clouds of /rear; --topic chooses another one (/front, /top)' in said
    page = (tmp_path / 'o' / 'report.html').read_text('utf-8')
    assert '--topic chooses another one' in page
    assert main([*arguments, '--overwrite', '--topic', '/front']) == 0
    assert 'chooses another' not in capsys.readouterr().err
    assert json.loads((tmp_path / 'o' / 'metrics.json').read_text())['frames'] == 2


def test_bag_without_truth_is_replayed_unscored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_room_bag(tmp_path / 'a.mcap', 3, truth=False)
    assert main(['replay', str(tmp_path / 'a.mcap'), '--out', str(tmp_path / 'o'), *KISS]) == 0
    assert 'no trajectory score: the bag holds no ground truth' in capsys.readouterr().err
    assert json.loads((tmp_path / 'o' / 'metrics.json').read_text())['trajectory'] is None


def test_cut_off_mcap_is_replayed_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_room_bag(tmp_path / 'a.mcap', 12, n=30000)
    data = (tmp_path / 'a.mcap').read_bytes()
    (tmp_path / 'a.mcap').write_bytes(data[: len(data) // 3])
    out = tmp_path / 'o'
    assert main(['replay', str(tmp_path / 'a.mcap'), '--out', str(out), *KISS]) == 0
    assert 'is cut off: recovered' in caplog.text
    metrics = json.loads((out / 'metrics.json').read_text())
    assert 2 <= metrics['frames'] <= 4
    assert metrics['recovered'] >= metrics['frames']


def test_bad_bags_give_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_room_bag(tmp_path / 'two.mcap', 1, topics=('/front', '/rear'))
    (tmp_path / 'no.mcap').write_bytes(b'hello')
    write_room_bag(tmp_path / 'cut.db3', 4)
    data = (tmp_path / 'cut.db3').read_bytes()
    (tmp_path / 'cut.db3').write_bytes(data[: len(data) // 2])
    with BagWriter(tmp_path / 'odom.mcap') as bag:
        bag.write_odometry('/odom', START, ('odom', 'base'), np.eye(4))
    for name, text in {
        'gone.mcap': 'no bag at',
        'no.mcap': 'cannot read bag',
        'cut.db3': '.recover',
        'odom.mcap': 'has no PointCloud2 topic',
    }.items():
        line = failure(
            capsys, ['replay', str(tmp_path / name), '--out', str(tmp_path / 'o'), *KISS]
        )
        assert text in line, line
    assert not (tmp_path / 'o').exists()
    arguments = ['replay', str(tmp_path / 'two.mcap'), '--out', str(tmp_path / 'o'), *KISS]
    assert main([*arguments, '--topic', '/rear']) == 0
    assert 'has no topic /top' in failure(capsys, [*arguments, '--topic', '/top', '--overwrite'])


def test_bad_settings_give_one_line(
    room_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / 'c.yaml'
    arguments = ['replay', str(room_bag), '--out', str(tmp_path / 'o')]
    for text, expected in {
        'registrarr: kiss-icp': 'unknown key registrarr; known keys',
        'map: {points_per_vox: 3}': 'unknown key map.points_per_vox',
        'voxel_size_m: -1': 'expected >= 0.0, found -1',
        'voxel_size_m: wide': 'expected float, found str',
        'a: [': 'is not YAML',
    }.items():
        config.write_text(text)
        assert expected in failure(capsys, [*arguments, '--config', str(config)])
    assert 'cannot read config' in failure(capsys, [*arguments, '--config', str(tmp_path / 'x')])
    for name, data in {
        'gone.safetensors': None,
        'cut.safetensors': b'\x10\x00\x00\x00\x00\x00\x00\x00{"a"',
        'pickle.pt': b'\x80\x02}q\x00.',
    }.items():
        if data is not None:
            (tmp_path / name).write_bytes(data)
        line = failure(capsys, [*arguments, '--weights', str(tmp_path / name)])
        assert name in line, line
    assert '--weights has no effect' in failure(capsys, [*arguments, '--weights', 'w', *KISS])
    assert '--stride' in failure(capsys, [*arguments, '--stride', '0'])
    assert '--stride cannot be combined with --live' in failure(
        capsys, [*arguments, '--live', '--stride', '2']
    )


def test_several_bags(room_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_room_bag(tmp_path / 'other.db3', 3)
    arguments = ['replay', str(room_bag), str(tmp_path / 'other.db3'), '--max-frames', '3', *KISS]
    result = tmp_path / 'r.json'
    assert main([*arguments, '--out', str(tmp_path / 'o'), '--json', str(result)]) == 0
    table = capsys.readouterr().out
    assert {p.name for p in (tmp_path / 'o').iterdir()} == {'room', 'other', 'index.html'}
    assert '\nroom ' in table
    assert '\nother ' in table
    assert set(json.loads(result.read_text())) == {str(room_bag), str(tmp_path / 'other.db3')}
    twice = ['replay', str(room_bag), str(room_bag), '--out', str(tmp_path / 'p'), *KISS]
    assert 'two bags of the same name' in failure(capsys, twice)


@pytest.mark.slow
def test_several_bags_on_a_local_dask_cluster(room_bag: Path, tmp_path: Path) -> None:
    pytest.importorskip('distributed')
    write_room_bag(tmp_path / 'other.mcap', 3)
    one, two = tmp_path / 'one', tmp_path / 'two'
    bags = [str(room_bag), str(tmp_path / 'other.mcap')]
    assert main(['replay', *bags, '--out', str(one), *KISS]) == 0
    assert main(['replay', *bags, '--out', str(two), *KISS, '--workers', '2']) == 0
    for name in ('room', 'other'):
        assert (one / name / 'odometry.tum').read_text() == (
            two / name / 'odometry.tum'
        ).read_text()


def test_ctrl_c_keeps_readable_outputs(tmp_path: Path) -> None:
    write_room_bag(tmp_path / 'a.mcap', 200)
    out = tmp_path / 'o'
    command = [sys.executable, '-m', 'hybridreg_ros.cli.main', 'replay', str(tmp_path / 'a.mcap')]
    process = subprocess.Popen(
        [*command, '--out', str(out), *KISS],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 200
    while time.monotonic() < end and process.poll() is None:
        tum = out / 'odometry.tum'
        if tum.exists() and len(tum.read_text().splitlines()) >= 3:
            break
        time.sleep(0.05)
    else:
        process.kill()
        pytest.fail(f'no third frame: {process.communicate()}')
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130, error
    assert 'interrupted (Ctrl-C)' in error
    assert 'Traceback' not in error
    metrics = json.loads((out / 'metrics.json').read_text())
    assert 3 <= metrics['frames'] < 200
    assert metrics['interrupted'] == 'interrupted (Ctrl-C)'
    with open_bag(out / 'dynamic.mcap') as bag:
        assert bag.recovered is None
        assert bag.topics['/hybridreg/odom'].messages == metrics['accepted']
    assert len((out / 'odometry.tum').read_text().splitlines()) == metrics['accepted']
    assert 'This run ended early' in (out / 'report.html').read_text('utf-8')
    assert {p.name for p in out.iterdir()} == OUTPUTS

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""How the node starts, refuses to start, takes parameters, and ends."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import DescribeParameters, ListParameters
from ros_harness import KISS, QUICK, STEP_NS, cloud, domain, room, running

from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros import odometry_node
from hybridreg_ros.ros.odometry_node import main
from hybridreg_ros.ros.parameters import leaves
from hybridreg_ros.ros.playback.node_process import LOCALHOST, NodeProcess

pytestmark = pytest.mark.ros


def start(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """The node with arguments that it must refuse."""
    return subprocess.run(
        [sys.executable, '-m', 'hybridreg_ros.ros.odometry_node', '--ros-args', *arguments],
        env={**os.environ, **LOCALHOST, 'ROS_DOMAIN_ID': str(domain()), **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        (('-p', 'voxel_size_m:=-1'), 'voxel_size_m: expected >= 0.0, found -1.0'),
        (('-p', 'gate.enter:=high'), "gate.enter: expected float, found str 'high'"),
        (('-p', 'drop_policy:=all'), 'drop_policy: expected one of oldest, newest'),
        (('-p', 'odom_frame:=/odom'), 'odom_frame: expected a frame without leading /'),
        (('-p', 'odom_frame:=""'), 'odom_frame: expected a frame name'),
        (('-p', 'base_frame:=odom'), 'base_frame: expected a frame other than odom_frame'),
        (('-p', 'extrinsic:=[0.0, 1.0]'), 'extrinsic: expected 7 numbers'),
        (('-p', 'extrinsic:=[0.,0.,0.,0.,0.,0.,0.]'), 'expected a unit quaternion, found norm 0'),
        (('-p', 'weights:=/nowhere/w.safetensors'), '/nowhere/w.safetensors'),
    ],
)
def test_bad_parameters_are_one_line_and_code_2(arguments, text, capfd, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain()))
    assert main(['--ros-args', *arguments]) == 2
    lines = [n for n in capfd.readouterr().err.splitlines() if n.startswith('odometry_node: ')]
    assert len(lines) == 1
    assert text in lines[0]


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        (('--params-file', '/nowhere.yaml'), 'parameter file /nowhere.yaml: No such file'),
        (('--params-file', '{broken}'), 'broken.yaml: while parsing a flow sequence'),
        (('--params-file', '{plain}'), 'plain.yaml: expected node names, found a str'),
        (('--params-file', '{mixed}'), 'Sequence should be of same type'),
        (('--params-file',), 'No file path provided'),
        (('-r', 'nonsense'), "Couldn't parse remap rule: '-r nonsense'"),
        (('--nonsense',), "ROS arguments not understood: ['--nonsense']"),
    ],
)
def test_bad_ros_arguments_are_one_line_and_code_2(arguments, text, tmp_path, capfd):
    texts = {
        'broken': 'a: [1, x',
        'plain': 'hello',
        'mixed': '/**: {ros__parameters: {a: [1, x]}}',
    }
    files = {name: tmp_path / f'{name}.yaml' for name in texts}
    for name, path in files.items():
        path.write_text(texts[name])
    assert main(['--ros-args', *(a.format(**files) for a in arguments)]) == 2
    line = capfd.readouterr().err
    assert line.startswith('odometry_node: ')
    assert line.count('\n') == 1
    assert text in line
    assert '.c:' not in line


@pytest.mark.parametrize(
    ('argument', 'code', 'text'),
    [
        ('--help', 0, '-r points:=/lidar/points'),
        ('--version', 0, 'odometry_node 0.'),
        ('--hlep', 2, 'unrecognized arguments: --hlep'),
        ('stray', 2, 'unrecognized arguments: stray'),
    ],
)
def test_help_version_and_strays_are_answered_without_a_start(argument, code, text, capfd):
    with pytest.raises(SystemExit) as end:
        main([argument, '--ros-args', '-r', 'points:=/lidar/points'])
    assert end.value.code == code
    assert text in ''.join(capfd.readouterr())


def test_threads_of_the_node_share_one_heap(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain()))
    asked = []
    monkeypatch.setattr(odometry_node, 'one_heap', lambda: asked.append(1))
    assert main(['--ros-args', '-p', 'voxel_size_m:=-1']) == 2
    assert asked == [1]


def test_unknown_parameter_in_a_process_of_its_own():
    done = start('-p', 'voxel_sise_m:=0.2')
    assert done.returncode == 2
    assert 'odometry_node: unknown parameter voxel_sise_m; known: ' in done.stderr
    assert 'Traceback' not in done.stderr


def test_pickled_weights_are_refused(tmp_path, capfd, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain()))
    path = tmp_path / 'model.pth'
    path.write_bytes(b'\x80\x04K\x01.')
    assert main(['--ros-args', '-p', f'weights:={path}']) == 2
    assert str(path) in capfd.readouterr().err


@pytest.fixture(scope='module')
def probe():
    """One node for the module, started without a network it was asked for."""
    with running('start', config=OdometryConfig()) as p:
        yield p


def test_no_weights_is_said_and_kiss_icp_used(probe):
    if 'packaged' in probe.values['weights']:
        pytest.skip('weights are packaged: there is nothing to be without')
    probe.wait(lambda: probe.level == DiagnosticStatus.WARN, 'a warning')
    assert 'no weights, kiss-icp alone' in probe.text
    probe.answer(cloud(room(), STEP_NS))
    probe.answer(cloud(room(0.05), 2 * STEP_NS))
    probe.wait(lambda: probe.values['reason'] == 'no_weights', 'the reason')
    assert probe.values['source'] == 'kiss_icp'


def test_every_field_is_a_parameter_with_text_and_range(probe):
    client = probe.node.create_client(ListParameters, 'hybridreg/list_parameters')
    assert client.wait_for_service(10.0)
    future = client.call_async(ListParameters.Request())
    probe.wait(future.done, 'the list')
    names = set(future.result().result.names)
    fields = {leaf.name: leaf for config in (KISS, QUICK) for leaf in leaves(config)}
    assert set(fields) <= names
    client = probe.node.create_client(DescribeParameters, 'hybridreg/describe_parameters')
    assert client.wait_for_service(10.0)
    future = client.call_async(DescribeParameters.Request(names=list(fields)))
    probe.wait(future.done, 'the descriptions')
    for name, found in zip(fields, future.result().descriptors, strict=True):
        leaf = fields[name]
        assert leaf.field.metadata['doc'] in found.description
        ranged = leaf.field.metadata['low'] is not None and leaf.kind in (int, float)
        assert bool(found.floating_point_range or found.integer_range) is ranged
        assert found.read_only is ('Read only' in found.description)


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('queue_depth', 0, r'queue_depth out of range.*Min: 1.*value: 0'),
        ('dynamics.threshold', 1.5, r'dynamics.threshold out of range.*Max: 1.0.*value: 1.5'),
        ('dynamics.threshold', 'a', r'Wrong parameter type'),
        ('dynamics.threshold', float('nan'), r'dynamics.threshold out of range.*nan'),
        ('drop_policy', 'some', r"drop_policy: expected one of oldest, newest, found 'some'"),
        ('voxel_size_m', 0.2, r'read-only parameter: voxel_size_m'),
        ('input_qos', 'reliable', r'read-only parameter: input_qos'),
        ('odom_frame', '/odom', r"odom_frame: expected a frame without leading /, found '/odom'"),
    ],
)
def test_changes_out_of_range_are_refused_with_the_reason(probe, name, value, reason):
    result = probe.set(name, value)
    assert not result.successful
    assert re.search(reason, result.reason), result.reason


def test_two_nodes_of_one_name_are_an_error_that_both_say(probe):
    levels = probe.watch_levels()
    space = probe.node.get_namespace()
    with NodeProcess((KISS, QUICK), space, domain()) as second:
        probe.wait(lambda: '1 more of this name publish the same odometry' in probe.text, 'word')
        assert DiagnosticStatus.ERROR in levels
        second.wait_until(lambda: 'twins: 1 more' in second.log.read_text(), 60.0, 'its warning')
        assert 'twins: 1 more' in probe.process.log.read_text()
        assert second.stop() == 0
    probe.wait(lambda: 'of this name' not in probe.text, 'the end of it')

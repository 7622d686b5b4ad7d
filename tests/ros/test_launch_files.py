# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Launch files, RViz set-up, package.xml and parameter files fit the code."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import sys
import types
from pathlib import Path
from typing import ClassVar
from xml.etree import ElementTree

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
LAUNCH = sorted((ROOT / 'launch').glob('*.launch.py'))
TOPICS = {'odom', 'dynamic_points', 'static_points', 'keyframe', 'path'}


@pytest.mark.parametrize('path', LAUNCH, ids=lambda p: p.name)
def test_launch_files_name_real_executables_and_files(path):
    text = path.read_text(encoding='utf-8')
    functions = [n.name for n in ast.parse(text).body if isinstance(n, ast.FunctionDef)]
    assert 'generate_launch_description' in functions
    entry_points = (ROOT / 'setup.py').read_text(encoding='utf-8')
    for name in re.findall(r"executable='(\w+)'", text):
        assert f'{name} = ' in entry_points or name == 'rviz2'
    for folder, name in re.findall(r"'(config|rviz|launch)', '([\w.]+)'", text):
        assert (ROOT / folder / name).is_file()


@pytest.mark.parametrize('path', LAUNCH, ids=lambda p: p.name)
def test_launch_description_is_made(path):
    pytest.importorskip('launch_ros', reason='launch_ros is not on PyPI (needs an installed ROS)')
    spec = importlib.util.spec_from_file_location(path.stem.replace('.', '_'), path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.generate_launch_description().entities


class _Stub:
    """Any class of launch or launch_ros: keeps its arguments; a configuration gives its value."""

    values: ClassVar[dict[str, str]] = {}

    def __init__(self, *arguments: object, **named: object) -> None:
        self.arguments, self.named = arguments, named

    def perform(self, _: object) -> str:
        return self.values.get(str(self.arguments[0]), '')


@pytest.fixture
def odometry_launch(monkeypatch):
    """The launch file as a module, with stubs where launch is not installed."""
    pytest.importorskip('ament_index_python')
    names = '. .actions .events .substitutions _ros _ros.actions _ros.event_handlers _ros.events'
    for name in (*names.split(), '_ros.events.lifecycle', '_ros.substitutions'):
        module = types.ModuleType('launch' + name.rstrip('.'))
        vars(module)['__getattr__'] = lambda kind: type(kind, (_Stub,), {})
        monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(_Stub, 'values', {'rviz': 'false', 'managed': 'false'})
    for name in ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'):
        monkeypatch.setenv(name, '')  # what the launch file sets is taken back
    path = ROOT / 'launch' / 'odometry.launch.py'
    spec = importlib.util.spec_from_file_location('odometry_launch', path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_nothing_is_started_when_rviz_is_wanted_and_missing(
    odometry_launch, monkeypatch, tmp_path
):
    def executables() -> list[str]:
        return [node.named['executable'] for node in odometry_launch.start_node(None)]

    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    assert executables() == ['odometry_node']
    _Stub.values['rviz'] = 'true'
    with pytest.raises(RuntimeError, match='rviz:=true needs rviz2: apt install'):
        executables()
    marker = tmp_path / 'share' / 'ament_index' / 'resource_index' / 'packages' / 'rviz2'
    marker.parent.mkdir(parents=True)
    marker.touch()
    assert executables() == ['odometry_node', 'rviz2']


def test_what_is_started_gets_the_shared_memory_profile(odometry_launch):
    odometry_launch.start_node(None)
    assert os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'].endswith('.xml')


@pytest.mark.parametrize(('autostart', 'transitions'), [('true', [3, 1]), ('false', [])])
def test_the_managed_node_is_configured_and_then_activated(
    odometry_launch, autostart, transitions
):
    _Stub.values.update(managed='true', autostart=autostart)
    node, *others = odometry_launch.start_node(None)
    assert type(node).__name__ == 'LifecycleNode'
    assert node.named['arguments'][0] == '--managed'
    if others:
        handler, first = others
        on_configured = handler.arguments[0]
        assert on_configured.named['target_lifecycle_node'] is node
        assert on_configured.named['goal_state'] == 'inactive'
        others = [on_configured.named['entities'][0], first]
    assert [e.named['event'].named['transition_id'] for e in others] == transitions
    _Stub.values.update(managed='false')
    (node,) = odometry_launch.start_node(None)
    assert type(node).__name__ == 'Node'
    assert node.named['arguments'][0] == '--ros-args'


def test_launch_arguments_are_parameters_of_the_node():
    pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')
    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.ros.node_config import NodeConfig
    from hybridreg_ros.ros.parameters import leaves

    configs = (NodeConfig(), OdometryConfig())
    known = {leaf.name for config in configs for leaf in leaves(config)} | {'use_sim_time'}
    tree = ast.parse((ROOT / 'launch' / 'odometry.launch.py').read_text(encoding='utf-8'))
    tables = {ast.unparse(n.targets[0]): n.value for n in tree.body if isinstance(n, ast.Assign)}
    used = set(ast.literal_eval(tables['PARAMETERS']))
    assert {'base_frame', 'use_sim_time'} <= used <= known


def test_rviz_shows_what_the_node_publishes():
    content = yaml.safe_load((ROOT / 'rviz' / 'odometry.rviz').read_text(encoding='utf-8'))
    displays = content['Visualization Manager']['Displays']
    topics = {d['Topic']['Value'] for d in displays if 'Topic' in d}
    assert topics <= {f'/hybridreg/{name}' for name in TOPICS}
    assert {'/hybridreg/odom', '/hybridreg/dynamic_points'} <= topics


def test_shipped_parameter_file_is_that_of_the_defaults():
    pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')
    from hybridreg_ros.core.config import load_yaml
    from hybridreg_ros.ros.node_config import NodeConfig, parameter_file

    path = ROOT / 'config' / 'node.yaml'
    assert path.read_text(encoding='utf-8') == parameter_file()
    assert load_yaml(NodeConfig, path) == NodeConfig()


def test_package_xml_names_every_message_package_and_the_same_version():
    root = ElementTree.parse(ROOT / 'package.xml').getroot()
    assert root.attrib['format'] == '3'
    assert root.findtext('name') == 'hybridreg_ros'
    assert f"version='{root.findtext('version')}'" in (ROOT / 'setup.py').read_text('utf-8')
    assert root.findtext('export/build_type') == 'ament_python'
    declared = {node.text for kind in ('exec_depend', 'depend') for node in root.iter(kind)}
    used = set()
    for path in [*(ROOT / 'hybridreg_ros' / 'ros').glob('*.py'), *LAUNCH]:
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.ImportFrom) and node.module:
                used.add(node.module.split('.')[0])
    ros = {n for n in used if n.endswith(('_msgs', '_srvs', '_interfaces')) or n.startswith('rcl')}
    assert ros | {'launch', 'launch_ros', 'tf2_msgs'} <= declared

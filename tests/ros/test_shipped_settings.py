# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Settings for sensors and for other packages: they parse, and the node accepts its part."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

pytest.importorskip('rclpy', reason='rclpy is not installed (pip install hybridreg_ros[ros])')

import rclpy
from ros_harness import domain

from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.parameters import ConfigParameters, leaves

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[2]
SENSORS = sorted((ROOT / 'config' / 'sensors').glob('*.yaml'))
OTHERS = sorted((ROOT / 'config' / 'with').glob('*.yaml'))
GUIDE = ROOT / 'docs' / 'guide'


def flat(values: dict, path: str = '') -> dict[str, object]:
    """Nested values by their dotted names."""
    found: dict[str, object] = {}
    for key, value in values.items():
        name = f'{path}{key}'
        found |= flat(value, f'{name}.') if isinstance(value, dict) else {name: value}
    return found


@pytest.mark.parametrize('path', [*SENSORS, *OTHERS], ids=lambda p: p.stem)
def test_the_node_accepts_it(path):
    context = rclpy.context.Context()
    context.init(domain_id=domain())
    try:
        node = rclpy.create_node(
            'hybridreg',
            context=context,
            cli_args=['--ros-args', '--params-file', str(path)],
            automatically_declare_parameters_from_overrides=True,
        )
        defaults = (OdometryConfig(), NodeConfig())
        settings = ConfigParameters(node, defaults, lambda _: False, lambda: None)
    finally:
        context.try_shutdown()
    content = yaml.safe_load(path.read_text('utf-8'))
    section = content['/**' if '/**' in content else 'hybridreg']
    wanted = flat(section['ros__parameters'])
    got = {leaf.name: leaf.default for c in settings.configs for leaf in leaves(c)}
    assert wanted
    assert {name: got[name] for name in wanted} == wanted


@pytest.mark.parametrize('path', OTHERS, ids=lambda p: p.stem)
def test_every_section_is_one_of_parameters(path):
    for name, section in yaml.safe_load(path.read_text('utf-8')).items():
        nested = section.get(name, section)  # Nav2's costmaps stand in a namespace of their name
        assert flat(nested['ros__parameters']), name


@pytest.mark.parametrize('path', [*SENSORS, *OTHERS], ids=lambda p: p.stem)
def test_a_page_names_it(path):
    pages = ' '.join(p.read_text('utf-8') for p in GUIDE.glob('*.md'))
    assert f'{path.parent.name}/{path.name}' in pages


def test_they_are_installed():
    setup = (ROOT / 'setup.py').read_text('utf-8')
    assert "shared('config/sensors')" in setup
    assert "shared('config/with')" in setup
    assert len(SENSORS) == 8
    assert len(OTHERS) == 4

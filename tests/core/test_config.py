# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import dataclass

import pytest
import yaml

from hybridreg_ros.core.config import dump_yaml, from_dict, load_yaml, option, to_dict, validate
from hybridreg_ros.core.errors import ConfigError


@dataclass(frozen=True)
class Inner:
    size_m: float = option(0.3, 'Edge of a voxel, metres.', low=0.01, high=5.0)
    count: int = option(4, 'How many.', low=1)

    def __post_init__(self) -> None:
        validate(self)


@dataclass(frozen=True)
class Outer:
    mode: str = option('a', 'Which way.', choices=('a', 'b'))
    enabled: bool = option(True, 'Switch.')
    xyz: tuple[float, ...] = option((0.0, 0.0, 1.0), 'A vector.', low=-9.0)
    limit: float | None = option(None, 'A limit, or none.')
    inner: Inner = option(Inner, 'The inner part.')

    def __post_init__(self) -> None:
        validate(self)


def test_round_trip_through_yaml(tmp_path):
    config = from_dict(Outer, {'mode': 'b', 'xyz': [1, 2, 3], 'inner': {'size_m': 1}})
    assert config.inner.size_m == 1.0
    assert isinstance(config.inner.size_m, float)
    path = tmp_path / 'c.yaml'
    path.write_text(dump_yaml(config))
    assert load_yaml(Outer, path) == config
    assert from_dict(Outer, to_dict(config)) == config


def test_dump_tells_range_and_choices():
    text = dump_yaml(Outer())
    assert '# Edge of a voxel, metres. [0.01..5]' in text
    assert '# Which way. [a | b]' in text
    assert yaml.safe_load(text)['inner']['count'] == 4


@pytest.mark.parametrize(
    'text',
    [
        '/**:\n  ros__parameters:\n    use_sim_time: true\n    mode: b\n    inner: {count: 7}\n',
        'hybridreg:\n  ros__parameters:\n    mode: b\n    inner.count: 7\n',
        'mode: b\ninner.count: 7\n',
    ],
)
def test_ros_parameter_files_read_alike(tmp_path, text):
    path = tmp_path / 'c.yaml'
    path.write_text(text)
    config = load_yaml(Outer, path)
    assert (config.mode, config.inner.count) == ('b', 7)


@pytest.mark.parametrize(
    ('values', 'text'),
    [
        ({'modus': 'a'}, 'unknown key modus; known keys: enabled, inner, limit, mode, xyz'),
        ({'inner': {'sise_m': 1}}, 'unknown key inner.sise_m'),
        ({'mode': 'c'}, "mode: expected one of a, b, found 'c'"),
        ({'inner': {'size_m': 9.0}}, 'inner.size_m: expected <= 5.0, found 9.0'),
        ({'inner': {'count': 0}}, 'inner.count: expected >= 1, found 0'),
        ({'inner': {'count': 1.5}}, 'inner.count: expected int, found float 1.5'),
        ({'inner': {'count': True}}, 'inner.count: expected int, found bool True'),
        ({'enabled': 1}, 'enabled: expected bool, found int 1'),
        ({'inner': {'size_m': 'big'}}, "inner.size_m: expected float, found str 'big'"),
        ({'inner': {'size_m': float('nan')}}, 'found NaN'),
        ({'xyz': [0, 'a', 0]}, r'xyz\[1\]: expected float'),
        ({'xyz': [0, -10, 0]}, 'xyz: expected >= -9'),
        ({'inner': 3}, 'expected a mapping, found 3'),
    ],
)
def test_bad_values_are_named(values, text):
    with pytest.raises(ConfigError, match=text):
        from_dict(Outer, values)


def test_bad_files(tmp_path):
    with pytest.raises(ConfigError, match=r'cannot read config .*missing\.yaml'):
        load_yaml(Outer, tmp_path / 'missing.yaml')
    path = tmp_path / 'c.yaml'
    path.write_text('a: [')
    with pytest.raises(ConfigError, match='is not YAML'):
        load_yaml(Outer, path)
    path.write_text('nope: 1')
    with pytest.raises(ConfigError, match=r'c\.yaml: unknown key nope'):
        load_yaml(Outer, path)
    path.write_text('mode: a\nmode.x: 1')
    with pytest.raises(ConfigError, match='conflicts'):
        load_yaml(Outer, path)

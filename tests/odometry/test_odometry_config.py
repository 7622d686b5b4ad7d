# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""OdometryConfig: defaults equal the shipped file, wrong values are refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from hybridreg_ros.core.config import from_dict, load_yaml
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.odometry.config import OdometryConfig, parameter_file

SHIPPED = Path(__file__).parents[2] / 'config' / 'odometry.yaml'


def test_shipped_file_is_the_dump_of_the_defaults() -> None:
    assert SHIPPED.read_text(encoding='utf-8') == parameter_file()
    assert load_yaml(OdometryConfig, SHIPPED) == OdometryConfig()


def test_every_number_has_a_range_and_every_field_a_description() -> None:
    def walk(config: object, path: str) -> None:
        for field in dataclasses.fields(config):  # type: ignore[arg-type]
            value = getattr(config, field.name)
            assert field.metadata['doc'], path + field.name
            if dataclasses.is_dataclass(value):
                walk(value, f'{path}{field.name}.')
            elif isinstance(value, (int, float, tuple)) and not isinstance(value, bool):
                assert field.metadata['low'] is not None, path + field.name
                assert field.metadata['high'] is not None, path + field.name

    walk(OdometryConfig(), '')


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'voxel_size_m': -0.1}, 'voxel_size_m: expected >= 0.0, found -0.1'),
        ({'registrar': 'magic'}, "registrar: expected one of hybridreg, kiss-icp, found 'magic'"),
        ({'gate': {'enter': 2.0}}, 'gate.enter: expected <= 1.0, found 2.0'),
        ({'map': {'sise': 1}}, 'unknown key map.sise; known keys: reach_m'),
    ],
)
def test_wrong_values_are_refused_with_one_line(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        from_dict(OdometryConfig, values)
    assert '\n' not in str(caught.value)

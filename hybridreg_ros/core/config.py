# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Configuration: nested frozen dataclasses whose fields carry their description and range.

One declaration serves the YAML files, the ROS parameters and the documentation.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from typing import TYPE_CHECKING, Any, TypeVar

import yaml

from hybridreg_ros.core.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

T = TypeVar('T')


def option(
    default: Any,
    doc: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
) -> Any:
    """Declare one field of a config dataclass.

    Args:
        default: its default value (immutable), or a config dataclass type for a nested section.
        doc: one sentence with the unit; becomes YAML comment and ROS parameter description.
        low: smallest allowed number, inclusive.
        high: largest allowed number, inclusive.
        choices: allowed strings.
    """
    metadata = {'doc': doc, 'low': low, 'high': high, 'choices': choices}
    if isinstance(default, type):
        return dataclasses.field(default_factory=default, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def validate(config: Any, path: str = '') -> None:
    """Check every field of a config dataclass against its type, range and choices.

    Call it from `__post_init__`.

    Raises:
        ConfigError: names the field, what was expected and what was found.
    """
    hints = typing.get_type_hints(type(config))
    for field in dataclasses.fields(config):
        name = f'{path}{field.name}'
        value = _checked_type(getattr(config, field.name), hints[field.name], name)
        object.__setattr__(config, field.name, value)
        _check_range(value, field.metadata, name)


def _checked_type(value: Any, hint: Any, name: str) -> Any:
    """Value converted losslessly to its declared type (int to float, list to tuple)."""
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        if value is None:
            return None
        hint = next(a for a in typing.get_args(hint) if a is not type(None))
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if typing.get_origin(hint) is tuple and isinstance(value, (list, tuple)):
        inner = typing.get_args(hint)[0]
        return tuple(_checked_type(v, inner, f'{name}[{i}]') for i, v in enumerate(value))
    plain = typing.get_origin(hint) or hint
    if not isinstance(value, plain) or (plain is int and isinstance(value, bool)):
        raise ConfigError(
            f'{name}: expected {plain.__name__}, found {type(value).__name__} {value!r}'
        )
    return value


def _check_range(value: Any, meta: typing.Mapping[str, Any], name: str) -> None:
    numbers = value if isinstance(value, tuple) else (value,)
    for v in numbers:
        if isinstance(v, float) and math.isnan(v):
            raise ConfigError(f'{name}: expected a number, found NaN')
        if isinstance(v, (int, float)) and not isinstance(v, bool):
            if meta.get('low') is not None and v < meta['low']:
                raise ConfigError(f'{name}: expected >= {meta["low"]}, found {v}')
            if meta.get('high') is not None and v > meta['high']:
                raise ConfigError(f'{name}: expected <= {meta["high"]}, found {v}')
        if meta.get('choices') and v not in meta['choices']:
            raise ConfigError(f'{name}: expected one of {", ".join(meta["choices"])}, found {v!r}')


def from_dict(cls: type[T], values: dict[str, Any], path: str = '') -> T:
    """Build a config from nested plain values; missing keys keep their defaults.

    Raises:
        ConfigError: a key is unknown (the message lists the known ones), or a value is wrong.
    """
    if not isinstance(values, dict):
        raise ConfigError(f'{path or cls.__name__}: expected a mapping, found {values!r}')
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    hints = typing.get_type_hints(cls)
    arguments: dict[str, Any] = {}
    for key, value in values.items():
        if key not in fields:
            known = ', '.join(sorted(fields))
            raise ConfigError(f'unknown key {path}{key!s}; known keys: {known}')
        if dataclasses.is_dataclass(hints[key]):
            arguments[key] = from_dict(typing.cast('type', hints[key]), value, f'{path}{key}.')
        else:
            arguments[key] = value
    try:
        return cls(**arguments)
    except ConfigError as error:
        raise ConfigError(f'{path}{error}') from None


def to_dict(config: Any) -> dict[str, Any]:
    """Nested plain values of a config (tuples become lists), ready for YAML, JSON or metadata."""
    return {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in (
            (
                f.name,
                to_dict(getattr(config, f.name))
                if dataclasses.is_dataclass(getattr(config, f.name))
                else getattr(config, f.name),
            )
            for f in dataclasses.fields(config)
        )
    }


def load_yaml(cls: type[T], path: str | Path) -> T:
    """Read a config from YAML: plain nested keys, or a ROS parameter file of the same keys.

    In a ROS parameter file the keys stand below `<node>: ros__parameters:`, nested or dotted.

    Raises:
        ConfigError: the file is missing, is not YAML, or holds an unknown key or a bad value.
    """
    try:
        with open(path, encoding='utf-8') as stream:
            values = yaml.safe_load(stream)
    except OSError as error:
        raise ConfigError(f'cannot read config {path}: {error.strerror}') from None
    except yaml.YAMLError as error:
        raise ConfigError(f'{path} is not YAML: {" ".join(str(error).split())}') from None
    try:
        return from_dict(cls, _nested(_ros_parameters(values or {})))
    except ConfigError as error:
        raise ConfigError(f'{path}: {error}') from None


def _ros_parameters(values: Any) -> Any:
    """Take the `ros__parameters` sections out of a ROS parameter file; other mappings stay."""
    if not isinstance(values, dict):
        return values
    sections = [v for v in values.values() if isinstance(v, dict) and 'ros__parameters' in v]
    if not sections:
        return values
    merged: dict[str, Any] = {}
    for section in sections:
        merged.update(section['ros__parameters'] or {})
    merged.pop('use_sim_time', None)
    return merged


def _nested(values: Any) -> Any:
    """Turn dotted keys into nested mappings."""
    if not isinstance(values, dict):
        return values
    result: dict[str, Any] = {}
    for key, value in values.items():
        *parents, last = str(key).split('.')
        place = result
        for parent in parents:
            place = place.setdefault(parent, {})
            if not isinstance(place, dict):
                raise ConfigError(f'key {key} conflicts with an earlier value of {parent}')
        nested = _nested(value)
        if isinstance(nested, dict) and isinstance(place.get(last), dict):
            place[last].update(nested)
        else:
            place[last] = nested
    return result


def dump_yaml(config: Any, indent: int = 0) -> str:
    """YAML text of a config with one comment per field: its description, range and choices."""
    pad = ' ' * indent
    lines: list[str] = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        lines.append(f'{pad}# {describe(field)}')
        if dataclasses.is_dataclass(value):
            lines.append(f'{pad}{field.name}:')
            lines.append(dump_yaml(value, indent + 2).rstrip('\n'))
        else:
            plain = list(value) if isinstance(value, tuple) else value
            text = yaml.safe_dump(plain, default_flow_style=True, width=1000).split('\n')[0]
            lines.append(f'{pad}{field.name}: {text}')
    return '\n'.join(lines) + '\n'


def describe(field: dataclasses.Field[Any]) -> str:
    """One line about a field: description, then its range or choices in brackets."""
    meta = field.metadata
    text = str(meta.get('doc', ''))
    if meta.get('choices'):
        return f'{text} [{" | ".join(meta["choices"])}]'
    if meta.get('low') is not None or meta.get('high') is not None:
        low = '' if meta.get('low') is None else f'{meta["low"]:g}'
        high = '' if meta.get('high') is None else f'{meta["high"]:g}'
        return f'{text} [{low}..{high}]'
    return text

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Config dataclasses as ROS parameters: declared with description and range, checked when set."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)

from hybridreg_ros.core.config import describe, from_dict, to_dict
from hybridreg_ros.core.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from rclpy.node import Node
    from rclpy.parameter import Parameter

RESTART = ' Read only: takes effect at start.'
_FOREIGN = ('use_sim_time', 'start_type_description_service')
_FOREIGN_PREFIXES = ('qos_overrides.',)
_INT64 = 2**63 - 1


@dataclass(frozen=True)
class Leaf:
    """One plain field of a nested config.

    Attributes:
        name: dotted path, the parameter's name.
        kind: bool, int, float, str or tuple.
        item: type of the items of a tuple, else as `kind`.
        optional: True when None is allowed; the parameter is then unset.
        default: value of the default config.
        field: the dataclass field with description, range and choices.
    """

    name: str
    kind: type
    item: type
    optional: bool
    default: Any
    field: dataclasses.Field[Any]


def leaves(config: Any, path: str = '') -> list[Leaf]:
    """Plain fields of a config and of its sections, in declaration order."""
    hints = typing.get_type_hints(type(config))
    found: list[Leaf] = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        name = f'{path}{field.name}'
        if dataclasses.is_dataclass(value):
            found += leaves(value, f'{name}.')
            continue
        hint, optional = hints[field.name], False
        if typing.get_origin(hint) in (types.UnionType, typing.Union):
            hint = next(a for a in typing.get_args(hint) if a is not type(None))
            optional = True
        kind = typing.get_origin(hint) or hint
        item = typing.get_args(hint)[0] if kind is tuple else kind
        found.append(Leaf(name, kind, item, optional, value, field))
    return found


def descriptor(leaf: Leaf, read_only: bool) -> ParameterDescriptor:
    """Descriptor of a field: description with choices, range, read-only mark."""
    text = describe(leaf.field) + (RESTART if read_only else '')
    result = ParameterDescriptor(
        description=text, read_only=read_only, dynamic_typing=leaf.optional
    )
    low, high = leaf.field.metadata.get('low'), leaf.field.metadata.get('high')
    if low is None and high is None:
        return result
    if leaf.kind is float:
        result.floating_point_range = [
            FloatingPointRange(
                from_value=-math.inf if low is None else float(low),
                to_value=math.inf if high is None else float(high),
            )
        ]
    elif leaf.kind is int:
        result.integer_range = [
            IntegerRange(
                from_value=-_INT64 if low is None else math.ceil(low),
                to_value=_INT64 if high is None else math.floor(high),
            )
        ]
    return result


class ConfigParameters:
    """Several config dataclasses kept equal to the parameters of one node.

    The node must be created with `automatically_declare_parameters_from_overrides=True`: what the
    user gave (file or command line) is then found as undescribed parameters, checked here as a
    whole, and declared anew with descriptions.

    Attributes:
        configs: the current config objects, in the order given.
    """

    def __init__(
        self,
        node: Node,
        defaults: Iterable[Any],
        read_only: Callable[[str], bool],
        on_change: Callable[[], None],
    ) -> None:
        """Declare every field.

        Args:
            node: the node that holds the parameters.
            defaults: config objects whose field names do not collide.
            read_only: tells by dotted name which parameters cannot change at run time.
            on_change: called after accepted changes, when `configs` is up to date.

        Raises:
            ConfigError: an override is unknown, of the wrong type or out of range.
        """
        self._on_change = on_change
        defaults = list(defaults)
        self._leaves: list[dict[str, Leaf]] = [{x.name: x for x in leaves(d)} for d in defaults]
        known = [name for group in self._leaves for name in group]
        if len(set(known)) != len(known):
            raise ValueError('two config classes share a field name')
        given = {n: p.value for n, p in node.get_parameters_by_prefix('').items()}
        _check_known(given, known)
        self.configs = [
            _changed(d, group, {n: v for n, v in given.items() if n in group})
            for d, group in zip(defaults, self._leaves, strict=True)
        ]
        for config, group in zip(self.configs, self._leaves, strict=True):
            _declare(node, config, group, read_only)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _candidates(self, parameters: list[Parameter]) -> list[Any]:
        values = {p.name: p.value for p in parameters}
        return [
            _changed(c, group, {n: v for n, v in values.items() if n in group})
            for c, group in zip(self.configs, self._leaves, strict=True)
        ]

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse a change that no config would accept, with the config's own reason."""
        try:
            self._candidates(parameters)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        self.configs = self._candidates(parameters)
        self._on_change()


def _check_known(given: Iterable[str], known: list[str]) -> None:
    for name in given:
        if name in known or name in _FOREIGN or name.startswith(_FOREIGN_PREFIXES):
            continue
        raise ConfigError(f'unknown parameter {name}; known: {", ".join(sorted(known))}')


def _declare(
    node: Node, config: Any, group: Mapping[str, Leaf], read_only: Callable[[str], bool]
) -> None:
    current = {leaf.name: leaf.default for leaf in leaves(config)}
    for name, leaf in group.items():
        if node.has_parameter(name):
            node.undeclare_parameter(name)
        value = current[name]
        plain = _array(value, leaf) if isinstance(value, tuple) else value
        node.declare_parameter(
            name, plain, descriptor(leaf, read_only(name)), ignore_override=True
        )


def _array(values: tuple[Any, ...], leaf: Leaf) -> Any:
    """Array parameter value; an empty one still has its type."""
    if leaf.item is float:
        return array('d', values)
    return array('q', values) if leaf.item is int else list(values)


def _changed(config: Any, group: Mapping[str, Leaf], values: Mapping[str, Any]) -> Any:
    """Config with some dotted values replaced.

    Raises:
        ConfigError: a value has the wrong type or lies outside its range.
    """
    if not values:
        return config
    nested = to_dict(config)
    for name, value in values.items():
        *parents, last = name.split('.')
        place = nested
        for parent in parents:
            place = place[parent]
        sequence = group[name].kind is tuple and isinstance(value, (list, tuple, array))
        place[last] = tuple(value) if sequence else value
    return from_dict(type(config), nested)

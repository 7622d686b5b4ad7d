# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Nested values, leaf by leaf."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from hybridreg_ros.core.nested import mapped


@dataclass(frozen=True)
class Pair:
    first: Any
    second: Any


class Named(NamedTuple):
    value: int


def test_every_leaf_is_changed_in_order() -> None:
    seen: list[Any] = []

    def change(leaf: Any) -> str:
        seen.append(leaf)
        return f'<{leaf}>'

    found = mapped(Pair((1, Pair(2, None)), 'x'), change)
    assert seen == [1, 2, None, 'x']
    assert found == Pair(('<1>', Pair('<2>', '<None>')), '<x>')


def test_lists_named_tuples_and_classes_are_leaves() -> None:
    leaves = [[1, 2], Named(3), Pair, {'a': 1}]
    for leaf in leaves:
        assert mapped(leaf, lambda found: (found,)) == (leaf,)

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the training tests."""

from conftest_training import one_thread, shards, tiny_run, tiny_weights

__all__ = ['one_thread', 'shards', 'tiny_run', 'tiny_weights']

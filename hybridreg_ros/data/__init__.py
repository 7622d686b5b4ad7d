# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Procedural scenes, sensors, pairs and loaders of public data sets."""

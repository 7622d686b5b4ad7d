# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bags run through the front end, offline or live; scores and report."""

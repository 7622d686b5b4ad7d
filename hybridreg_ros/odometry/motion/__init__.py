# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""How the sensor moves: prediction from scan to scan, and scan continuity."""

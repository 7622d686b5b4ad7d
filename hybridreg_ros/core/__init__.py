# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Basic types without any heavy import: errors, config, transforms, scans, provenance."""

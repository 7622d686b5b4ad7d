# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The network as torch modules: what trains, and what the compiled functions are compared with."""

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Ways to run: through the node, on many inputs at once, many logs one after the other."""

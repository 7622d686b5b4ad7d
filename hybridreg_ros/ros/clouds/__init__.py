# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Where clouds come from: subscriptions, the queue, the second sensor."""

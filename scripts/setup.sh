#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
#
# Makes .venv with everything that `make demo` (argument: demo) or `make test` (argument: test)
# needs. Run again, it does only what is missing.
set -euo pipefail
cd "$(dirname "$0")/.."
purpose=${1:?usage: scripts/setup.sh demo|test}
venv=${VENV:-.venv}

say() { printf 'setup: %s\n' "$*" >&2; }
die() { say "$*"; exit 2; }

# 1. System libraries: what is missing is installed as root, named otherwise.
missing=()
has_library() { /sbin/ldconfig -p 2>/dev/null | grep -q "$1"; }
if [ "$purpose" = test ]; then
  has_library libusb-1.0.so.0 || missing+=(libusb-1.0-0)   # open3d
  has_library libgomp.so.1 || missing+=(libgomp1)          # open3d
  has_library libX11.so.6 || missing+=(libx11-6)           # open3d
  has_library libGL.so.1 || missing+=(libgl1)              # open3d
  command -v chromium >/dev/null || command -v chromium-browser >/dev/null \
    || command -v google-chrome >/dev/null || missing+=(chromium)   # the report in a browser
  command -v cmake >/dev/null || missing+=(cmake)          # tf2_msgs for the /tf test
  command -v g++ >/dev/null || missing+=(g++)
fi

# 2. A Python that the ROS Jazzy wheels support.
python=''
for candidate in ${PYTHON:-} python3 python3.12 python3.11; do
  if "$candidate" -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12)))' 2>/dev/null
  then python=$(command -v "$candidate"); break; fi
done
[ -n "$python" ] || die "needs Python 3.11 or 3.12; set PYTHON=/path/to/python3.12 and run make again"
"$python" -c 'import ensurepip' 2>/dev/null \
  || missing+=("$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')")

if [ ${#missing[@]} -gt 0 ]; then
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    say "installing system packages: ${missing[*]}"
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null \
      || die "apt-get could not install: ${missing[*]}"
  else
    die "missing system packages: ${missing[*]}. Run: sudo apt-get install ${missing[*]}"
  fi
fi

# 3. The virtual environment. The ROS wheels need a real venv: they find their libraries in it.
if [ ! -x "$venv/bin/python" ] || ! "$venv/bin/python" -c 'import pip' 2>/dev/null; then
  say "making $venv with $("$python" --version)"
  "$python" -m venv --clear "$venv"
fi
extras='ros,replay,data'
[ "$purpose" = test ] && extras="$extras,bench,scale,view,test,docs"
# An outer ROS wheel environment must not leak into this one.
unset LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE PYTHONPATH
pip() { "$venv/bin/python" -m pip --disable-pip-version-check -q "$@"; }
say "installing Python packages for make $purpose (constraints.txt; the first time takes minutes)"
pip install -c constraints.txt 'setuptools>=77.0.3,<80' wheel
pip install -c constraints.txt --no-build-isolation -e ".[$extras]"
if [ "$purpose" = test ]; then
  "$venv/bin/python" scripts/build_tf2_msgs.py --quiet \
    || say "tf2_msgs could not be built: the tests of /tf will be skipped (see the message above)"
fi
touch "$venv/.ready-$purpose"
[ "$purpose" = demo ] || touch "$venv/.ready-demo"
say "done"

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
#
# `make demo` and `make test` set themselves up (scripts/setup.sh) on a fresh machine.

VENV ?= .venv
PY := $(VENV)/bin/python
INPUTS := scripts/setup.sh setup.py constraints.txt
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
export OMP_NUM_THREADS ?= 2
export NO_MKDOCS_2_WARNING ?= 1

.PHONY: help demo test test-slow bench goals docs lint colcon setup clean

help:  ## say what the targets do
	@grep -E '^[a-z-]+:.*##' Makefile | sed 's/:.*##/ —/'

$(VENV)/.ready-demo: $(INPUTS)
	VENV=$(VENV) bash scripts/setup.sh demo

$(VENV)/.ready-test: $(INPUTS) scripts/build_tf2_msgs.py
	VENV=$(VENV) bash scripts/setup.sh test

setup: $(VENV)/.ready-test  ## everything that the other targets need

demo: $(VENV)/.ready-demo  ## simulate, play over DDS into the real node, score, write out/demo/report.html
	$(VENV)/bin/hybridreg warm-up
	$(VENV)/bin/hybridreg demo --out out/demo

test: $(VENV)/.ready-test lint  ## all fast tests: unit, property, ROS over DDS, browser
	$(VENV)/bin/hybridreg warm-up
	$(PY) -m pytest

test-slow: $(VENV)/.ready-test  ## the long tests: colcon, transport, kill and resume, overfit
	$(PY) -m pytest -m slow

bench: $(VENV)/.ready-test  ## milliseconds per stage, side by side with the peers
	$(VENV)/bin/hybridreg bench

goals: $(VENV)/.ready-test  ## every row of the registration table of docs/results/registration.md (hours)
	PATH="$(abspath $(VENV))/bin:$$PATH" bash scripts/goals.sh

docs: $(VENV)/.ready-test  ## the documentation as a site, out/site/index.html
	$(PY) -m mkdocs build --strict --quiet

lint: $(VENV)/.ready-test  ## ruff, codespell and mypy, as CI runs them
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m codespell_lib $(shell git ls-files 2>/dev/null)
	$(PY) -m mypy

colcon: $(VENV)/.ready-test  ## colcon build and colcon test in a workspace of their own
	$(PY) -m pytest -m slow tests/ros -k colcon

clean:  ## remove the virtual environment and everything generated
	rm -rf $(VENV) out build install log *.egg-info

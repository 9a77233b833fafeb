# One virtual environment, .venv, filled in stages; each stage leaves a stamp, so a second run does nothing.
# ARGS goes to the command:  make demo ARGS="--vehicles 5 --headless"

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -qq
INSTALL := .ci/install $(BIN)
UV_VERSION := 0.13.9
ARGS ?=
# Tests run in so many processes. What runs in real time stays in two of them (tests/conftest.py), which mostly wait: so
# more than there are processors.
WORKERS := 3
PYTEST = $(BIN)/python -m pytest -q --numprocesses $(WORKERS) --dist loadfile --no-loadscope-reorder

.PHONY: help demo paper test test-fast coverage wheel dist campaign lint bench docs requirements clean kernels all-kernels

help:
	@echo "make demo          router, services and simulated vehicles on this machine"
	@echo "make paper         the paper's tables and figures, recomputed"
	@echo "make test          lint, documentation, tests"
	@echo "make test-fast     tests that need neither processes in real time nor more than a few seconds"
	@echo "make coverage      all tests, and how much of the code they run"
	@echo "make dist          source distribution and wheels into dist/, one with machine code of the kernels"
	@echo "make wheel         build the wheel, install it into a fresh environment, run it there"
	@echo "make campaign      every property on 1000 examples from a fresh seed; FLEET_TEST_EXAMPLES=100000 and"
	@echo "                   FLEET_TEST_SEED=N say otherwise, ARGS goes to pytest"
	@echo "make lint          ruff, mypy, import order of the packages, spelling"
	@echo "make docs          the documentation into site/"
	@echo "make bench         speed and tightness beside peers, into bench/"
	@echo "make requirements  pin anew from pyproject.toml (ARGS=--upgrade: newest versions)"
	@echo "make clean         remove everything that make has made, $(VENV) too"

demo: kernels
	@$(BIN)/fleet demo $(ARGS)

paper: all-kernels
	@$(BIN)/fleet paper $(ARGS)

test: lint docs all-kernels
	@$(PYTEST) $(ARGS)

test-fast: $(VENV)/.dev all-kernels
	@$(PYTEST) -m "not slow and not integration" $(ARGS)

# What processes that a test starts run, and what is compiled to machine code, is not counted.
coverage: $(VENV)/.dev all-kernels
	@$(PYTEST) --cov --cov-report term:skip-covered $(ARGS)

wheel: $(VENV)/.dev
	@$(BIN)/python .ci/wheel.py

# A wheel with machine code of the kernels starts without compiling anything.
dist: $(VENV)/.dev
	@$(BIN)/python .ci/wheel.py dist

campaign: $(VENV)/.dev all-kernels
	@FLEET_TEST_SEED="$${FLEET_TEST_SEED:-fresh}" FLEET_TEST_EXAMPLES="$${FLEET_TEST_EXAMPLES:-1000}" \
	    $(BIN)/python -m pytest -v -m property $(ARGS)

lint: $(VENV)/.dev
	@$(BIN)/ruff check --quiet .
	@$(BIN)/ruff format --check --quiet .
	@$(BIN)/mypy --strict --no-error-summary
	@said=$$($(BIN)/lint-imports --no-logo --no-cache 2>&1) || { echo "$$said" >&2; exit 1; }
	@$(BIN)/codespell

docs: $(VENV)/.dev
	@# Not --quiet: what is not logged, --strict does not count.
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --site-dir site

bench: $(VENV)/.dev all-kernels
	@$(BIN)/fleet bench $(ARGS)

# The first python that is new enough and can make a virtual environment; PYTHON=... overrides.
$(VENV)/.python:
	@for python in $(or $(PYTHON),python3.11 python3.12 python3.13 python3.14 python3); do \
	    if "$$python" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
	        echo "making $(VENV) with $$("$$python" --version)"; \
	        "$$python" -m venv --clear $(VENV); \
	        touch $@; \
	        exit 0; \
	    fi; \
	done; \
	echo "No Python >= 3.11 with venv found. Install one (Debian: python3 python3-venv)" \
	    "or name it: make PYTHON=/path/to/python3.11" >&2; \
	exit 1

# uv takes seconds where pip takes a minute; where it cannot be had or fails, pip does the work.
$(VENV)/.uv: requirements/uv.txt | $(VENV)/.python
	@$(PIP) install --require-hashes -r $< || echo "uv cannot be had: pip installs, which takes longer" >&2
	@touch $@

$(VENV)/.runtime: requirements/runtime.txt | $(VENV)/.uv
	@echo "installing $< ($$(grep -c '==' $<) packages)"
	@$(INSTALL) --require-hashes -r $<
	@touch $@

# Every package carries a py.typed: a new package is installed too.
$(VENV)/.project: pyproject.toml $(VENV)/.runtime $(wildcard */py.typed)
	@$(PIP) install --no-deps --no-build-isolation --editable .
	@touch $@

# Kernels are compiled at their first call; the first demo need not wait for that in the middle of a drive. No stamp: they
# are cached by their sources, so that this takes seconds where nothing is to be done, and only looking tells.
kernels: $(VENV)/.project
	@$(BIN)/python -m reach_server.service.warm_up set_membership

all-kernels: $(VENV)/.project
	@$(BIN)/python -m reach_server.service.warm_up

$(VENV)/.dev: requirements/dev.txt $(VENV)/.project
	@echo "installing $< ($$(grep -c '==' $<) packages)"
	@$(INSTALL) --require-hashes -r $<
	@touch $@

# The smaller sets take their versions from dev.txt, so that all three agree.
COMPILE = $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --fork-strategy fewest \
    --generate-hashes --no-emit-index-url --no-emit-find-links \
    --custom-compile-command "make requirements" --group build pyproject.toml
# uv does not read pip's settings: hand it the mirror that pip would use.
requirements: $(VENV)/.python
	@$(PIP) install uv==$(UV_VERSION)
	@if [ -n "$${PIP_INDEX_URL:-}" ]; then export UV_DEFAULT_INDEX="$$PIP_INDEX_URL"; fi; \
	mkdir -p requirements; \
	echo "uv==$(UV_VERSION)" | $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
	    --no-emit-index-url --no-emit-find-links --custom-compile-command "make requirements" - \
	    -o requirements/uv.txt; \
	$(COMPILE) $(ARGS) --extra dev -o requirements/dev.txt; \
	$(COMPILE) $(ARGS) --extra agent --extra server --extra pictures --extra recorder --extra dashboard --extra foxglove \
	    --constraints requirements/dev.txt -o requirements/runtime.txt; \
	$(COMPILE) $(ARGS) --extra agent --constraints requirements/dev.txt -o requirements/agent.txt; \
	if grep -nE '://|index-url|find-links' requirements/*.txt; then \
	    echo "an address got into requirements/" >&2; exit 1; \
	fi

clean:
	rm -rf $(VENV) site build dist *.egg-info .hypothesis .coverage .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

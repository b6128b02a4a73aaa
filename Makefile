# `make` alone lists the targets. Python >= 3.11 and make are all that the first target needs.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed

.DEFAULT_GOAL := help
.PHONY: help demo test test-all test-extras test-wheel test-lowest lint format types count bench animation docs clean

help:  ## list the targets
	@sed -n 's/^\([a-z-]*\):.*##  *\(.*\)/\1\t\2/p' $(firstword $(MAKEFILE_LIST)) | expand -t 14

demo: $(BIN)/usnet  ## play one game; replay, page, picture and episode file go to runs/demo/
	$(BIN)/usnet demo

# Each of the tests' processes would compile all modules anew where Python may not keep them compiled.
test test-all test-wheel: export PYTHONDONTWRITEBYTECODE =

test: $(INSTALLED)  ## run the quick tests
	$(BIN)/pytest -n auto --dist worksteal -m "not slow"

test-all: $(INSTALLED)  ## run all tests and show the coverage
	$(BIN)/pytest -n auto --dist worksteal --cov=usnet_env --cov=detectors

test-extras:  ## test each extra in a separate environment; takes half an hour
	PYTHON=$(PYTHON) tests/frameworks/extras.sh

test-wheel:  ## install as the README says, with the newest versions, and test that outside of the repository
	$(PYTHON) tests/packaging/install.py newest

test-lowest:  ## run the package with the lowest versions of its dependencies that are allowed
	$(PYTHON) tests/packaging/install.py lowest

lint: $(INSTALLED)  ## check style, format and the imports between the parts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

format: $(INSTALLED)  ## format the code
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

types: $(INSTALLED)  ## check the types
	$(BIN)/mypy

count:  ## print the size of the project: lines, words, refusals, long files
	@$(PYTHON) tests/packaging/count.py

bench: $(INSTALLED)  ## measure the speed of the simulator; numbers are in benchmarks/
	$(BIN)/python benchmarks/speed.py

animation: $(INSTALLED)  ## play the demo and write docs/images/game.gif
	$(BIN)/usnet demo
	$(BIN)/usnet replay runs/demo/episode.npz --animation docs/images/game.gif

docs: $(INSTALLED)  ## build the pages in docs/_build/
	$(BIN)/sphinx-build -W --keep-going -q docs docs/_build

clean:  ## remove build outputs and caches; runs/ and the virtual environment stay
	rm -rf docs/_build docs/generated build dist .coverage htmlcov .pytest_cache .mypy_cache .ruff_cache .hypothesis \
		.import_linter_cache
	find usnet_env detectors tests docs benchmarks examples -name __pycache__ -prune -exec rm -rf {} +

# What the demo needs is small; what tests and pages need are some gigabytes.
$(BIN)/usnet:
	@$(call install,replay)

$(INSTALLED): pyproject.toml
	@$(call install,dev)
	@touch $@

define install
$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	echo "USNET needs Python 3.11 or newer, and $(PYTHON) is" \
		"$$($(PYTHON) --version 2>/dev/null || echo not installed). Choose another: make PYTHON=python3.12 …" >&2; \
	exit 1; }; \
test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV) || exit; \
echo "Installing into $(VENV), which takes some minutes the first time …"; \
$(BIN)/pip install --quiet --quiet --editable '.[$(1)]'
endef

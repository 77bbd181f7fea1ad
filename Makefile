# make demo   the method comparison, into out/demo     make lint   ruff and pyright
# make test   the tests                                make clean  remove all that make made
# make test-all    with notebooks, pages and more cases   make test-fast   the quick ones
# make fuzz, make faults   damaged inputs (COUNT=100000); kills (COUNT=500), full disks, caches
# make test-oldest   the suite on the lowest version of every dependency (docs/reliability.md)
# make bench  speed ratios against peers               make docs   the documentation, into out/docs
# make figures, make screenshots   figures of the documentation, pictures of recordings: docs/images
# make torture  a thousand random tasks, or COUNT=50 of them  (docs/torture.md)
# make suite  published problems by the defaults       (docs/suite.md)
# make wheel  wheel and source archive into dist, checked   (CONTRIBUTING.md)
# Everything is installed by pip, from the index it is configured for, into .venv.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

PYTHON ?= python3
VENV := .venv
OLDEST := .venv-oldest
BIN := $(VENV)/bin
PIP := PIP_DISABLE_PIP_VERSION_CHECK=1 $(BIN)/python -m pip install -qq
OUT := out/demo
SITE := out/docs

.PHONY: help demo test test-all test-fast fuzz faults test-oldest test-environment bench suite torture docs figures screenshots lint wheel clean

help:
	@sed -n 's/^# \{0,1\}//p' Makefile | head -10

# A stamp newer than pyproject.toml means that its packages are installed.
$(VENV)/.made:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	    echo "microbot_ocp needs Python 3.11 or newer, but '$(PYTHON)' is" \
	      "$$($(PYTHON) --version 2>&1 || true). Choose one: make PYTHON=/path/to/python3.12" >&2; \
	    exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	    echo "$$($(PYTHON) --version) cannot make virtual environments: ensurepip is missing." \
	      "On Debian and Ubuntu: apt install python3-venv" >&2; \
	    exit 1; }
	@$(BIN)/python -c 'import pip, sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	    echo "making $(VENV) with $$($(PYTHON) --version)"; \
	    $(PYTHON) -m venv --clear $(VENV); }
	@touch $@

$(VENV)/.ready: pyproject.toml | $(VENV)/.made
	@echo "installing microbot_ocp into $(VENV)"
	@$(PIP) -e .
	@touch $@

$(VENV)/.ready-%: pyproject.toml | $(VENV)/.made
	@echo "installing microbot_ocp[$*] into $(VENV)"
	@$(PIP) -e '.[$*]'
	@touch $@ $(VENV)/.ready

demo: $(VENV)/.ready
	@$(BIN)/microbot-ocp demo --out $(OUT)
	@echo; echo "Outputs in $(OUT):"
	@find $(OUT) -type f | sort | sed 's/^/  /'
	@echo "Pictures and tables open in any viewer; a recording (.rrd) opens with:"
	@find $(OUT) -name '*.rrd' | sort | sed 's|.*|  $(BIN)/microbot-ocp replay & --open|'

test-environment: $(VENV)/.ready-test
	@:

test: test-environment
	@$(BIN)/python -m pytest -n 2 --dist worksteal -m 'not pages and not thorough'

test-all: test-environment
	@$(BIN)/python -m pytest -n 2 --dist worksteal

test-fast: test-environment
	@$(BIN)/python -m pytest -n 2 --dist worksteal -m 'not slow and not thorough' tests

# Cases at random, from where the record of the last run ends, then those that atheris chooses by the
# lines that they reach.
FUZZED := motion solution comparison robot_file urdf task cell study sweep scene
fuzz: test-environment $(VENV)/.ready-fuzz
	@mkdir -p out
	@$(BIN)/python tests/reliability/fuzz.py all $(or $(COUNT),100000) --record out/fuzz.jsonl
	@for target in $(FUZZED); do echo "atheris: $$target"; \
	    $(BIN)/python tests/reliability/fuzz.py $$target $(or $(COUNT),100000) --atheris; done

faults: test-environment
	@MICROBOT_OCP_KILLS=$(or $(COUNT),500) $(BIN)/python -m pytest -q -s tests/_base/test_codegen.py \
	    tests/reliability/test_faults.py tests/reliability/test_network.py

# The lowest version that pyproject.toml allows of everything it names; pictures of figures are
# compared with matplotlib 3.11 only.
test-oldest: | $(VENV)/.made
	@$(PIP) uv
	@$(BIN)/uv venv -q --seed --clear --python $(BIN)/python $(OLDEST)
	@echo 'matplotlib==3.8.*' > $(OLDEST)/overrides.txt
	@VIRTUAL_ENV=$(OLDEST) UV_FIND_LINKS="$${PIP_FIND_LINKS:-}" $(BIN)/uv pip install -q \
	    --resolution lowest-direct --overrides $(OLDEST)/overrides.txt -e '.[test]'
	@$(OLDEST)/bin/python -m pip check
	@$(OLDEST)/bin/python -m pytest -o addopts='--doctest-modules --strict-markers' -n 2 --dist worksteal

bench: $(VENV)/.ready-bench
	@$(BIN)/python -m benchmarks

torture: $(VENV)/.ready-bench
	@$(BIN)/python -m benchmarks torture --count $(or $(COUNT),1000)

suite: $(VENV)/.ready
	@$(BIN)/python -m benchmarks suite

docs: $(VENV)/.ready-docs
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build
	@$(BIN)/python docs/tools/links.py $(SITE) >/dev/null
	@echo "Open $(SITE)/index.html"

figures: test-environment
	@$(BIN)/python docs/make_figures.py

screenshots: test-environment
	@$(BIN)/python docs/make_screenshots.py

lint: $(VENV)/.ready-test
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@PYRIGHT_PYTHON_IGNORE_WARNINGS=1 $(BIN)/pyright
	@{ git log -20 --format=%s 2>/dev/null || true; } | awk 'length($$0) > 72 { \
	    print "commit subject longer than 72 characters: " $$0; bad = 1 } END { exit bad }'

wheel: $(VENV)/.ready-release
	@rm -rf dist
	@$(BIN)/python -m build --no-isolation --outdir dist . >/dev/null
	@$(BIN)/python -m twine check --strict dist/*

clean:
	rm -rf $(VENV) $(OLDEST) out dist build .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

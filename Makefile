# `make demo` and `make test` prepare everything they need. `make help` lists all.

# Folder of the Python environment; made when missing.
VENV ?= .venv
# Python to make it with; the first one that is new enough when empty.
PYTHON3 ?=

BIN := $(VENV)/bin
STAMP := $(VENV)/.slipmap-installed
.DEFAULT_GOAL := help
.PHONY: help demo test quick lint types bench notebooks docs install clean

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## /{printf "  make %-9s %s\n", $$1, $$2}' Makefile

demo: $(STAMP) ## Long demo: a simulated robot finds its table's tilt and grasps a hammer, see demo/; short: slipmap demo
	@$(BIN)/slipmap pregrasp --scenario docs/examples/tilted-table.yaml --adapt --seed 2 --output demo --record demo/recording.html

test: $(STAMP) ## Run all tests
	@$(BIN)/python -m pytest -q -n 2 --dist loadfile

quick: $(STAMP) ## Run the tests without plant, browser or twin: two minutes, longer while kernels are compiled
	@$(BIN)/python -m pytest -q -n 2 --dist loadfile --quick

lint: $(STAMP) ## Check style, formatting, and which way imports point
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/lint-imports --no-cache

types: $(STAMP) ## Check types
	@$(BIN)/mypy

bench: $(STAMP) ## Measure how fast slipmap is on this machine
	@$(BIN)/slipmap bench

notebooks: $(STAMP) ## Run the notebooks anew and keep what they show
	@$(BIN)/python notebooks/run.py notebooks/*.ipynb

docs: $(STAMP) ## Build the pages of docs/ as a site that can be searched: site/index.html
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

install: $(STAMP) ## Install slipmap into its environment, which the others do by themselves

# Python 3.11 or newer that can make environments; candidates that do not run are passed over.
$(STAMP): pyproject.toml
	@set -e; found=; python=; \
	if ! $(BIN)/python -m pip --version >/dev/null 2>&1; then \
	    for candidate in $(or $(PYTHON3),python3 python3.13 python3.12 python3.11); do \
	        version=$$($$candidate --version 2>/dev/null || true); found="$$found$${version:+$$version, }"; \
	        if $$candidate -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then python=$$candidate; break; fi; \
	    done; \
	    if [ -z "$$python" ]; then \
	        echo "slipmap needs Python 3.11 or newer, found $${found:-none, }which is not enough. Debian 12, Ubuntu 24.04 and later have it:" \
	             "sudo apt-get install python3 python3-venv. Elsewhere see https://www.python.org/downloads and" \
	             "name it: make PYTHON3=/path/to/python3" >&2; exit 2; \
	    fi; \
	    if ! $$python -c 'import ensurepip, venv' 2>/dev/null; then \
	        echo "$$python cannot make environments: sudo apt-get install python3-venv, then try again" >&2; exit 2; \
	    fi; \
	    echo "making the environment $(VENV) with $$($$python --version)"; \
	    $$python -m venv --clear $(VENV); \
	fi
	@echo "installing slipmap and what it needs into $(VENV), once; this can take some minutes"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test]'
	@$(BIN)/python .ci/system_libraries.py
	@echo "slipmap is installed; \`. $(BIN)/activate\` puts its commands on your path"
	@touch $(STAMP)

clean: ## Remove the demo's results, caches and build products; the environment stays
	rm -rf demo simulated-demo tilted site notebooks/results build dist .src/slipmap.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -exec rm -rf {} +

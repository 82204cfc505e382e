# phase_ppl: `make demo` and `make test` do everything from a fresh clone, on Linux and macOS.
# Settings go on the command line: make demo EVENT=opposing SEED=3, make test PYTHON=python3.13
.POSIX:
.SUFFIXES:

# Pythons to try, in this order, for the virtual environment.
PYTHON = python3.11 python3.12 python3.13 python3.14 python3 python
# What the demo infers, SIMPLE's planner, and the folder for the results.
EVENT = collaborate
PLANNER = fast
SEED = 0
OUT = demo-out
# What is installed to test with; without PyTorch: make test EXTRAS=dev,oracle
EXTRAS = dev,neural,oracle
# More arguments for pytest, such as ARGS="tests/world -k goal", and its processes.
ARGS =
JOBS = auto

VENV = .venv
BIN = $(VENV)/bin
INSTALL = $(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt

.PHONY: help demo docs test test-all check lint types imports dist format clean

help:
	@echo "make demo     infer who wants what in a bundled event, by both models; results in $(OUT)/"
	@echo "make test     run the tests; make test-all those too that take long"
	@echo "make check    lint, types and imports together:"
	@echo "make lint       style and format of the code (ruff)"
	@echo "make types      type hints (mypy)"
	@echo "make imports    which folder imports which (import-linter)"
	@echo "make dist     build the package into dist/, and check it as an index would"
	@echo "make format   put the code into the project's format"
	@echo "make docs     build the documentation site in site/"
	@echo "make clean    remove the virtual environment, caches and demo-out/"

# SIMPLE runs beside the closed loop and is told after it: together they take a third less.
demo: $(VENV)/.installed
	@mkdir -p $(OUT)
	@echo "The closed loop: each frame is explained by those before it, under all hypotheses."
	@$(BIN)/phase-ppl infer $(EVENT) --model simple --planner $(PLANNER) --seed $(SEED) \
	    --out $(OUT)/simple --overwrite --quiet >$(OUT)/simple.txt 2>&1 & simple=$$!; \
	trap 'kill $$simple 2>/dev/null || :' EXIT; trap 'exit 130' INT TERM; \
	$(BIN)/phase-ppl infer $(EVENT) --seed $(SEED) --out $(OUT)/closed_loop --overwrite; \
	echo; \
	echo "SIMPLE: hypotheses are sampled, and whole simulations are compared with the video."; \
	code=0; wait $$simple || code=$$?; cat $(OUT)/simple.txt; rm $(OUT)/simple.txt; exit $$code

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal --durations 40 --durations-min 4 $(ARGS)

test-all: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m 'slow or not slow' $(ARGS)

check: lint types imports

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check

types: $(VENV)/.installed-dev
	$(BIN)/mypy

imports: $(VENV)/.installed-dev
	$(BIN)/lint-imports

docs: $(VENV)/.installed-docs
	$(BIN)/mkdocs build

dist: $(VENV)/.installed-dev
	rm -rf dist
	PIP_CONSTRAINT=$$PWD/constraints.txt $(BIN)/python -m build
	$(BIN)/twine check --strict dist/*

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix-only
	$(BIN)/ruff format

clean:
	rm -rf $(VENV) demo-out site build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis
	rm -rf .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# --- the virtual environment -----------------------------------------------------------------
# The files .installed and .installed-dev in it say that an installation went through; a newer
# pyproject.toml or constraints.txt makes it run again.

$(VENV)/.installed: $(BIN)/python pyproject.toml constraints.txt
	@echo "Installing phase_ppl into $(VENV); the first time takes a few minutes."
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(BIN)/python -m ensurepip
	$(INSTALL) -e .
	@touch $@

$(VENV)/.installed-dev: $(BIN)/python pyproject.toml constraints.txt
	@echo "Installing phase_ppl and its tests into $(VENV); the first time takes a few minutes."
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(BIN)/python -m ensurepip
	$(INSTALL) -e '.[$(EXTRAS)]'
	@touch $(VENV)/.installed $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(INSTALL) -e '.[docs]'
	@touch $@

$(BIN)/python:
	@set -e; found=; no_venv=; \
	for python in $(PYTHON); do \
	    "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || continue; \
	    if "$$python" -c 'import ensurepip, venv' 2>/dev/null; then found=$$python; break; fi; \
	    no_venv=$$python; \
	done; \
	if [ -z "$$found" ] && [ -n "$$no_venv" ]; then \
	    echo "$$no_venv cannot create virtual environments: its module venv or ensurepip is" \
	        "missing. On Debian and Ubuntu install the package $$no_venv-venv." >&2; \
	    exit 1; \
	fi; \
	if [ -z "$$found" ]; then \
	    echo "No Python 3.11 or newer was found (tried: $(PYTHON))." \
	        "Install one, or name it: make ... PYTHON=/path/to/python" >&2; \
	    exit 1; \
	fi; \
	echo "Creating $(VENV) with $$found, $$("$$found" --version)"; \
	"$$found" -m venv --clear $(VENV)

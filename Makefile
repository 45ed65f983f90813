# Every target sets up .venv first. Requires Python 3.11 or newer and make.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
OUT ?= demo
ARGS ?=
PYTEST = $(BIN)/python -m pytest --numprocesses auto --dist worksteal
.DEFAULT_GOAL := help
# Without byte code on disk, every process that a test starts compiles the package again: .4 s.
unexport PYTHONDONTWRITEBYTECODE
.PHONY: help demo test test-all golden golden-accept check format bench docs release size clean

help:  ## list the targets; CONTRIBUTING.md lists other commands
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 15

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and \
		"anisomap needs Python 3.11 or newer, and $(PYTHON) is " + sys.version.split()[0] + \
		": name another with make PYTHON=python3.13")'
	@echo "Setting up .venv (once, about a minute) ..."
	@$(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt pip
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
		--editable '.[all]' --group dev
	@touch $@

demo: $(READY)  ## simulate a skin, map it and score the map, in demo/
	@$(BIN)/anisomap demo --output-dir $(OUT)

test: $(READY)  ## run the tests, all but the slow ones (about three minutes)
	$(PYTEST) -m "not slow"

test-all: $(READY)  ## run all tests
	$(PYTEST)

golden: $(READY)  ## compare the maps of fixed recordings with the record (ARGS=--exact for the same arithmetic)
	$(BIN)/python -m tests.golden $(ARGS)

golden-accept: $(READY)  ## write the rows that differ to the record, in tests/golden
	$(BIN)/python -m tests.golden --accept $(ARGS)

check: $(READY)  ## check format, lint, types and imports between packages
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(READY)  ## format the code
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

bench: $(READY)  ## time maps and verdicts against corrcoef and Isomap, in bench/ (ARGS="--large --first-seed 1")
	$(BIN)/python -m benchmarks.speed.bench $(ARGS)

docs: $(READY)  ## build the documentation, in docs/_build/html
	$(BIN)/sphinx-build -W --keep-going -b html docs docs/_build/html

release: $(READY)  ## build wheel and sdist, check them in an empty environment, and write the notes, in dist/
	$(BIN)/python .ci/release.py $(ARGS)

size: $(READY)  ## count lines, functions and modules, and those that a map passes
	@$(BIN)/python -m benchmarks.size -o docs/development/size-table.md

clean:  ## remove the output of all targets
	rm -rf .venv demo bench fuzz quality noise faults trust dimension paper-out docs/_build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .coverage htmlcov

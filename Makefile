# One word each; every target sets up what it needs in .venv. Python 3.11+ and make are enough.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
OUT ?= demo
OUT_PAPER ?= paper-out
RECORDINGS ?=
LARGE ?=
ARGS ?=
.DEFAULT_GOAL := help
.PHONY: help demo paper numbers test check format bench quality docs clean

help:  ## this list
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and \
		"anisomap needs Python 3.11 or newer, and $(PYTHON) is " + sys.version.split()[0] + \
		": name another with make PYTHON=python3.12")'
	@echo "Setting up .venv (once, about a minute) ..."
	@$(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt pip
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
		--editable '.[all]' --group dev
	@touch $@

demo: $(READY)  ## simulate a skin, map it, score the map: picture, report and CSV in demo/
	@$(BIN)/anisomap demo --output-dir $(OUT)

paper: $(READY)  ## every figure and table of the paper, in paper-out/ (RECORDINGS=folder adds real skin)
	@$(BIN)/anisomap paper --output-dir $(OUT_PAPER) $(if $(RECORDINGS),--recordings $(RECORDINGS))

numbers: paper  ## the numbers in README and docs, from what make paper left
	$(BIN)/python -m anisomap.paper.numbers $(OUT_PAPER) docs/results docs/explanation/paper.md README.md

test: $(READY)  ## every test
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile

check: $(READY)  ## format, lint, types, architecture
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(READY)  ## put the code into the project's format
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

bench: $(READY)  ## every stage and whole maps against what others do, in bench/ (LARGE=1, ARGS=--quick)
	$(BIN)/python -m benchmarks $(if $(RECORDINGS),--recordings $(RECORDINGS)) $(if $(LARGE),--large) $(ARGS)
	$(BIN)/python -m benchmarks.simulation

quality: $(READY)  ## how true the maps of every method are; RECORDINGS=folder adds real ones
	$(BIN)/python -m benchmarks.quality -o quality $(if $(RECORDINGS),--recordings $(RECORDINGS))

docs: $(READY)  ## the documentation, in docs/_build/html
	$(BIN)/sphinx-build -W --keep-going -b html docs docs/_build/html

clean:  ## remove what the other targets made
	rm -rf .venv demo bench quality paper-out docs/_build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis

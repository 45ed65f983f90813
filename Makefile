# Every target sets up .venv first. Requires Python 3.11 or newer and make.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
OUT ?= demo
OUT_PAPER ?= paper-out
RECORDINGS ?=
LARGE ?=
SEED ?=
ARGS ?=
PYTEST = $(BIN)/python -m pytest --numprocesses auto --dist worksteal
.DEFAULT_GOAL := help
# Without byte code on disk, every process that a test starts compiles the package again: .4 s.
unexport PYTHONDONTWRITEBYTECODE
.PHONY: help demo paper numbers test test-all test-random test-profiles coverage golden golden-accept check format bench quality noise faults trust dimension fuzz tables docs release size clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 15

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

demo: $(READY)  ## simulate a skin, map it and score the map, in demo/
	@$(BIN)/anisomap demo --output-dir $(OUT)

paper: $(READY)  ## reproduce the paper, in paper-out/ (RECORDINGS=folder adds real recordings)
	@$(BIN)/anisomap paper --output-dir $(OUT_PAPER) $(if $(RECORDINGS),--recordings $(RECORDINGS))

numbers: paper  ## update the numbers of the paper in the docs, on seeds 1 to 10 and 11 to 20
	@$(BIN)/anisomap paper --output-dir $(OUT_PAPER)/unseen --first-seed 11 $(if $(RECORDINGS),--recordings $(RECORDINGS)) \
		--only claims --only figure-3 --only figure-4 --only figure-7 --only ablations
	cp $(OUT_PAPER)/claims/claims.csv docs/results/claims-seeds-1-to-10.csv
	cp $(OUT_PAPER)/settings/settings.csv $(OUT_PAPER)/settings/settings-best.csv docs/results/
	cp $(OUT_PAPER)/settings/settings.png docs/_static/
	$(BIN)/python -m benchmarks.numbers $(OUT_PAPER)/unseen docs/results docs/explanation/paper.md

test: $(READY)  ## run the tests, all but the slow ones (about three minutes)
	$(PYTEST) -m "not slow"

test-all: $(READY)  ## run all tests
	$(PYTEST)

test-random: $(READY)  ## run the property tests with new examples (ARGS=tests/numerics)
	$(PYTEST) --hypothesis-profile random -m "not slow" $(ARGS)

test-profiles: $(READY)  ## run the tests under several kinds of arithmetic (ARGS="--only numba-generic tests/numerics")
	$(BIN)/python -m tests.profiles $(ARGS)

coverage: $(READY)  ## measure which lines and branches the tests run
	$(PYTEST) -m "not slow" --cov --cov-report=term

golden: $(READY)  ## compare the maps of fixed recordings with the record (ARGS=--exact for the same arithmetic)
	$(BIN)/python -m golden $(ARGS)

golden-accept: $(READY)  ## write the rows that differ to the record, in tests/golden
	$(BIN)/python -m golden --accept $(ARGS)

check: $(READY)  ## check format, lint, types and imports between packages
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(READY)  ## format the code
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

bench: $(READY)  ## time maps and verdicts against corrcoef and Isomap, in bench/ (LARGE=1, SEED=1, ARGS="--sizes 60x4000")
	$(BIN)/python -m benchmarks.speed.bench $(if $(LARGE),--large) $(if $(SEED),--first-seed $(SEED)) $(ARGS)

quality: $(READY)  ## measure the accuracy of every method, in quality/ (RECORDINGS=folders adds real recordings)
	$(BIN)/python -m benchmarks.accuracy.quality -o quality $(if $(RECORDINGS),--recordings $(RECORDINGS))
	$(BIN)/python -m benchmarks.accuracy.steps -o quality $(if $(RECORDINGS),--recordings $(RECORDINGS))
	$(if $(RECORDINGS),$(BIN)/python -m benchmarks.accuracy.limits -o quality --recordings $(RECORDINGS))

noise: $(READY)  ## map skins under growing white noise, in noise/ (ARGS="--seeds 2")
	$(BIN)/python -m benchmarks.accuracy.noise -o noise $(ARGS)

tables: $(READY)  ## update the tables of accuracy in README, paper and docs from the results of make quality, faults and trust
	cp quality/*-table.md docs/development/
	cp quality/quality.png docs/_static/
	cp quality/quality.csv $(wildcard quality/limits.csv) docs/results/
	$(BIN)/python -m benchmarks.numbers quality docs/results README.md paper/paper.md docs/explanation/accuracy.md
	if [ -d faults ]; then cp faults/faults-table.md docs/development/; cp faults/faults.csv docs/results/; fi
	if [ -d dimension ]; then cp dimension/dimension-table.md docs/development/; cp dimension/dimension.csv docs/results/; fi
	if [ -d noise ]; then cp noise/noise-table.md docs/development/; fi
	if [ -d bench ]; then cp bench/bench-table.md docs/development/; fi
	if [ -d trust ]; then cp trust/trust-table.md docs/development/; cp trust/trust.png docs/_static/; cp trust/trust.csv docs/results/; fi

faults: $(READY)  ## measure which damages of recordings are found and mended, in faults/ (RECORDINGS=folder)
	$(BIN)/python -m benchmarks.verdicts.faults -o faults $(if $(RECORDINGS),--recordings $(RECORDINGS)) $(ARGS)

trust: $(READY)  ## compare verdicts with the errors of 180 maps, in trust/ (RECORDINGS=folders, ARGS="--seeds 200")
	$(BIN)/python -m benchmarks.verdicts.trust -o trust $(if $(RECORDINGS),--recordings $(RECORDINGS)) $(ARGS)

dimension: $(READY)  ## measure how often the number of dimensions is right, in dimension/ (RECORDINGS=folders)
	$(BIN)/python -m benchmarks.accuracy.dimension -o dimension $(if $(RECORDINGS),--recordings $(RECORDINGS)) $(ARGS)

fuzz: $(READY)  ## read 100,000 damaged files of all formats, in fuzz/ (ARGS="--cases 5000 --formats npz")
	$(BIN)/python -m fuzzing $(ARGS)

docs: $(READY)  ## build the documentation, in docs/_build/html
	$(BIN)/sphinx-build -W --keep-going -b html docs docs/_build/html

release: $(READY)  ## build wheel and sdist, check them in an empty environment, and write the notes, in dist/
	$(BIN)/python .ci/release.py $(ARGS)

size: $(READY)  ## count lines, functions and modules, and those that a map passes
	@$(BIN)/python -m benchmarks.size -o docs/development/size-table.md

clean:  ## remove the output of all targets
	rm -rf .venv .venv-lowest-versions demo bench fuzz quality noise faults trust dimension paper-out docs/_build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .coverage htmlcov

# `make demo` and `make test` set up their own environment in .venv: a fresh checkout needs Python 3.11 and make only.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

# What `make benchmark` measures, and whether only parts that take about a minute: make benchmark QUESTIONS=gait QUICK=1
QUESTIONS ?= accuracy cameras peers uncertainty wrong_inputs gait robots thesis net speed
QUICK ?=
DEMO_OUT := demo-output
# Where the tests' torch comes from.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu

# What the environment was installed from: it is set up once, and again when one of these changes.
REQUIREMENTS := pyproject.toml constraints.txt
BASE := $(VENV)/.base-installed
DEV := $(VENV)/.dev-installed

# Keep pyright from asking the network for a newer version.
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1
# Compiled modules are kept, whatever the environment says: the tests start many processes.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help demo test test-all test-lowest test-quick lint format docs docs-version docs-figures notebooks samples benchmark wheel clean

help:
	@echo 'make demo       reconstruct the sample clip into $(DEMO_OUT)/'
	@echo 'make test       ruff, pyright and the tests, but for those marked slow'
	@echo 'make test-all   the same with the slow tests: all notebooks, statistics of many fits, fuzz, the site'
	@echo 'make test-quick  the tests of files, commands, fits and pages, without types and style'
	@echo 'make test-lowest  the same with the lowest versions that pyproject.toml allows'
	@echo 'make lint       ruff, the rules on names and types, pyright'
	@echo 'make format     let ruff fix and format the code'
	@echo 'make docs       the documentation site into site/'
	@echo 'make docs-version SITES=folder  the same, beside the sites of earlier versions'
	@echo 'make notebooks  run the notebooks and save their outputs'
	@echo 'make samples    make the clips in data/samples again'
	@echo 'make benchmark  measure accuracy, speed and more, and make the tables of docs/ from it'
	@echo 'make wheel      the package into dist/, installed and tried in a clean environment'
	@echo 'make clean      remove outputs and caches; $(VENV) stays'

demo: $(BASE)
	$(BIN)/recon demo --out $(DEMO_OUT) --overwrite
	@echo
	@echo 'The results are in $(DEMO_OUT)/. To play them back: $(BIN)/recon view $(DEMO_OUT)'

# pytest comes last, so that its summary is the last line. Tests run in one process for each processor.
test: lint
	$(BIN)/python -m pytest -m 'not slow' --numprocesses logical --maxprocesses 8 --dist worksteal

test-all: lint
	$(BIN)/python -m pytest --numprocesses logical --maxprocesses 8 --dist worksteal

# Files in and out, commands, fits and pages: what other versions of the packages can break.
QUICK := $(foreach name,calibrate calibration camera cli compare convert doctor documents export file_names files io \
	io_formats motion motion_file overlay package page plots python report settings tables terms video view,\
	$(wildcard tests/test_$(name).py tests/*/test_$(name).py))

test-quick: $(DEV)
	$(BIN)/python -m pytest --numprocesses logical --maxprocesses 8 --dist worksteal $(QUICK)

# In an environment of its own: old packages warn of things that nobody can mend here, so warnings are no errors.
LOWEST := build/lowest

test-lowest: $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	$(BIN)/uv venv --quiet --allow-existing --python $(BIN)/python $(LOWEST)
	$(BIN)/uv pip install --quiet --python $(LOWEST) --resolution lowest-direct -e '.[formats]'
	$(BIN)/uv pip install --quiet --python $(LOWEST) 'pytest>=8' pytest-xdist
	$(LOWEST)/bin/python -m pytest -o filterwarnings=default --disable-warnings \
		--numprocesses logical --maxprocesses 8 --dist worksteal $(QUICK)

lint: $(DEV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python benchmarks/house.py --check
	$(BIN)/pyright

format: $(DEV)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(DEV)
	rm -rf site
	PYTHONPATH=docs $(BIN)/python -m zensical build --clean --strict
	$(BIN)/python docs/live_page.py site/live

docs-version: docs
	$(BIN)/python docs/versions.py $(SITES)

docs-figures: $(DEV)
	$(BIN)/python docs/figures.py

notebooks: $(DEV)
	$(BIN)/python notebooks/run.py

samples: $(BASE)
	$(BIN)/python data/samples/make_samples.py
	$(BIN)/python data/samples/make_rendered.py

benchmark: $(BASE)
	for question in $(QUESTIONS); do $(BIN)/python benchmarks/$$question.py $(if $(QUICK),--quick) || exit 1; done
	$(BIN)/python benchmarks/tables.py

# What is released: built, installed into an environment of its own, and run there.
wheel: $(BASE)
	rm -rf dist build/clean
	$(PIP) build
	$(BIN)/python -m build --outdir dist
	$(PYTHON) -m venv build/clean
	build/clean/bin/python -m pip install --quiet -c constraints.txt dist/*.whl
	cd build && clean/bin/recon --version && clean/bin/recon demo --out clean/demo --quiet
	cd build && clean/bin/python -c 'import recon; print(recon.Motion.load("clean/demo"))'

clean:
	rm -rf $(DEMO_OUT) build dist site .cache .pytest_cache .ruff_cache
	find recon tests benchmarks pipelines data -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)

$(BASE): $(REQUIREMENTS) | $(BIN)/python
	$(PIP) -e .
	@touch $@

# torch by itself first: its build for the CPU, much smaller than the one with CUDA, comes from an index of its own.
# Where that cannot be reached, pip looks in the usual places.
$(DEV): $(REQUIREMENTS) | $(BIN)/python
	$(PIP) --quiet --no-deps --retries 1 --extra-index-url $(TORCH_INDEX) torch
	$(PIP) -e '.[dev,net]'
	@touch $(BASE) $@

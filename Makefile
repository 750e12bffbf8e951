# `make demo` and `make test` work on a fresh machine with Python >= 3.11 and make, and nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
KERNELS := $(VENV)/.compiled
# torch's and Numba's thread pools spin against each other otherwise (3-10x slower when anything else runs), and so do
# OpenBLAS's threads over matrices too small to share (docs/decisions/kernels.md).
export OMP_WAIT_POLICY := PASSIVE
export OPENBLAS_NUM_THREADS := 1
# Where nothing compiled may be kept, every process of the tests compiles all of them anew (a third of a minute).
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install environment demo test quick nightly test-as stability kernel check wheel platforms newest docs benchmarks clients clean

help:
	@echo "make demo   simulate an exposure of a photographed scene and reconstruct it (about two minutes once installed)"
	@echo "make test   the tests; TESTS=... for some of them"
	@echo "make quick  the tests of what has changed since the last commit, without the slow ones (BASE=... another revision)"
	@echo "make nightly  the tests with those too dear for every commit, the whole hard cases, the wheel, another processor"
	@echo "make test-as CPU=haswell [TESTS=...]  the same as on another processor: haswell, nehalem, znver1, ..."
	@echo "make stability  every hard case end to end; writes docs/stability.md"
	@echo "make kernel the drivers against a real kernel; RIG=path names the script that boots the guest"
	@echo "make check  ruff, mypy, import-linter"
	@echo "make wheel  build sdist and wheel into dist/, install them into empty environments, use them"
	@echo "make platforms  whether wheels of all that is needed can be had for other machines and Pythons"
	@echo "make newest  a part of the tests on the newest Python that is here, with the newest releases"
	@echo "make docs   the documentation site, into site/"
	@echo "make benchmarks  the measured figures: rasteriser against torch, bundle adjustments against each other"
	@echo "make clients  what the newest of other people's programs make of a run's exports; RUN=runs/demo/run, needs npm"
	@echo "make clean  remove .venv, caches and runs"

install: $(KERNELS)

# Without the kernels, which `check`, `wheel` and `docs` do not call: `make -j3 install check wheel` does all at once.
environment: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

$(KERNELS): $(STAMP)
	$(BIN)/gs2ci compile
	@touch $@

demo: install
	$(BIN)/gs2ci demo -o runs/demo

# What pytest is told, such as TESTS=tests/reconstruct; by default all of them, in two processes. Files marked `slow` come
# first (tests/conftest.py): one that begins last keeps one processor waiting.
TESTS ?= -n 2 --dist loadfile --no-loadscope-reorder

test: install
	$(BIN)/pytest $(TESTS)

BASE ?= HEAD

quick: install
	$(BIN)/python -m tests.quick $(BASE)

nightly: install
	$(BIN)/pytest $(TESTS) --nightly
	$(BIN)/python -m tests.stability
	$(BIN)/python -m tests.wheel
	$(BIN)/python -m tests.processors haswell -m pytest $(TESTS) tests/render tests/reconstruct

test-as: install
	$(BIN)/python -m tests.processors $(CPU) -m pytest $(TESTS)

stability: install
	$(BIN)/python -m tests.stability

# Every night, and not among the tests: other people's newest releases change without us.
RUN ?= runs/demo/run
clients: install
	$(BIN)/python -m tests.clients $(RUN) -o docs/clients.md

kernel: install
	GS2CI_KERNEL_RIG="$(RIG)" $(BIN)/pytest -v tests/kernel

check: environment
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# WHEEL=--quick borrows the installed packages instead of fetching them for the second environment, and compiles nothing.
wheel: environment
	$(BIN)/python -m tests.wheel $(WHEEL)

# What users of other machines and Pythons would meet.
platforms: environment
	$(BIN)/python -m tests.platforms

newest: environment
	$(BIN)/python -m tests.newest

docs: environment
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

benchmarks: install
	$(BIN)/python -m tests.benchmarks

clean:
	rm -rf $(VENV) runs build dist site .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

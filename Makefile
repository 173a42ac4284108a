# saranga-bench: `make demo` flies one judged course, `make test` runs what continuous integration runs.
# Everything installs into .venv with the versions pinned in constraints.txt; nothing else is needed by hand
# on a machine with python3, make and gcc.

PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
EXTRAS := .venv/.installed-extras
# One BLAS thread: the matrices are small, and simulators run side by side.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export NUMBA_NUM_THREADS ?= 1

.PHONY: help venv demo sitl flights test test-slow kernels lint bench clean

help:
	@echo "make demo       set up and fly one judged course through poles on the embedded autopilot"
	@echo "make sitl       get ArduPilot's published ArduCopter SITL build, where it is not there yet"
	@echo "make flights    the short suite on real ArduCopter (AUTOPILOT=embedded TRIALS=20 RUNS=runs BASELINE=RUN)"
	@echo "make test       lint, types, layers and the tests (what continuous integration runs)"
	@echo "make test-slow  the tests that take minutes (many seeds, wall time), real ArduCopter where present"
	@echo "make lint       ruff, mypy and import-linter"
	@echo "make bench      benchmarks (pytest-benchmark) of wire, acoustics, perception and whole flights"
	@echo "make venv       only make .venv"

venv: $(STAMP)

$(STAMP): pyproject.toml constraints.txt tools/make_venv.sh
	@PYTHON="$(PYTHON)" sh tools/make_venv.sh
	@touch $(STAMP)

# PyTorch and the optional runtimes: training, export and their tests.
$(EXTRAS): $(STAMP)
	@echo "installing PyTorch and the optional runtimes into .venv (another 1.5 GB)"
	@$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev,train,openvino,litert,cluster]'
	@touch $(EXTRAS)

demo: $(STAMP)
	@$(BIN)/saranga-bench fly poles --autopilot embedded --seed 1 --out runs

sitl: $(STAMP)
	$(BIN)/saranga-bench sitl install

AUTOPILOT ?= arducopter
TRIALS ?= 20
RUNS ?= runs
flights: $(STAMP)
	$(BIN)/saranga-bench fly poles --autopilot $(AUTOPILOT) --trials $(TRIALS) --out $(RUNS) $(if $(BASELINE),--baseline $(BASELINE))

lint: $(EXTRAS)
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Lint on one core while the kernels compile on the other.
test: $(EXTRAS)
	@$(MAKE) --no-print-directory -j2 -O lint kernels
	$(BIN)/python -m pytest -n 2 --dist loadgroup --durations=40 -m "not slow" --ignore=tests/benchmarks --cov --cov-report=term:skip-covered

kernels: $(STAMP)
	@$(BIN)/python tools/warm_kernels.py

test-slow: $(EXTRAS)
	$(BIN)/python -m pytest -m slow

bench: $(EXTRAS)
	$(BIN)/python -m pytest tests/benchmarks --benchmark-only --benchmark-columns=min,median,max,rounds -p no:xdist --no-cov

clean:
	rm -rf .venv build dist .mypy_cache .ruff_cache .pytest_cache .coverage*

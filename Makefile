# Every target makes .venv when it is missing; all that is needed is Python 3.11 and make.
PYTHON ?= python3
BIN := .venv/bin
ARGS ?=
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check

.PHONY: install demo wheel test test-all machines check size report bench soak fuzz docs clean

install: .venv/installed

demo: .venv/installed
	$(BIN)/telepulse demo $(ARGS)

wheel: .venv/bin/python
	$(PIP) wheel --no-deps --wheel-dir out/wheels .

# The tests start a thousand processes. Where this is set, as in many containers, each would compile the
# packages anew.
unexport PYTHONDONTWRITEBYTECODE

# The arrays are small: with BLAS on all cores, identification takes four times the processor time.
test test-all: export OPENBLAS_NUM_THREADS := 1

# Static checks, unit tests, and a smoke test of each capability through real processes.
test: check
	$(BIN)/python -m pytest --quick --durations=15 $(ARGS)

# Every test; COVERAGE=1 adds the coverage of the core.
test-all: check .venv/installed-test-all
	$(BIN)/python -m tests.run_all --durations=15 $(ARGS)

# The tests of `make test` on other Pythons, processors, settings and versions; ARGS="--list" lists them.
machines: .venv/bin/python
	$(BIN)/python -m tests.machines $(ARGS)

check: .venv/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Fails where product, tests, or benchmarks, soak and fuzz are larger than their limits.
size: .venv/installed-test
	$(BIN)/python -m tests.size

report: .venv/installed-report
	$(BIN)/telepulse paper

bench: .venv/installed-test-all
	$(BIN)/python -m benchmarks $(ARGS)

soak: .venv/installed
	$(BIN)/python -m soak $(ARGS)

fuzz: .venv/installed-fuzz
	$(BIN)/python -m fuzz $(ARGS)

docs: .venv/installed-test-all
	$(BIN)/python -m sphinx -W --keep-going -n -E docs out/docs

clean:
	rm -rf .venv out

.venv/bin/python:
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml constraints.txt | .venv/bin/python
	$(PIP) install -c constraints.txt -e '.[view]'
	touch $@

.venv/installed-report: .venv/installed
	$(PIP) install -c constraints.txt -e '.[report]'
	touch $@

.venv/installed-fuzz: .venv/installed-test
	$(PIP) install -c constraints.txt -e '.[fuzz]'
	touch $@

.venv/installed-test: .venv/installed
	$(PIP) install -c constraints.txt -e '.[test]'
	touch $@

.venv/installed-test-all: .venv/installed-test
	$(PIP) install -c constraints.txt -e '.[test-all]'
	touch $@

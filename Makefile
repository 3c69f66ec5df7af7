# Every target makes .venv when it is missing; all that is needed is Python 3.11 and make.
PYTHON ?= python3
BIN := .venv/bin
ARGS ?=

.PHONY: install demo test test-all check compile size report bench soak fuzz docs clean

install: .venv/installed

demo: .venv/installed
	$(BIN)/telepulse demo $(ARGS)

# The arrays are small: with BLAS on all cores, identification takes four times the processor time.
test test-all: export OPENBLAS_NUM_THREADS := 1

# Static checks, unit tests, and a smoke test of each capability through real processes.
test: check
	$(BIN)/python -m pytest -m "smoke or not system" $(ARGS)

# Every test, with the coverage of the core.
test-all: check
	$(BIN)/python -m tests.run_all $(ARGS)

check: compile
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The tests start a thousand processes. Where PYTHONDONTWRITEBYTECODE is set, as in many containers, each
# would compile the packages anew.
compile: .venv/installed-test
	$(BIN)/python -m compileall -q protocol pulse_sensors sensing_node display_node telepulse

# Limits: the product 30000 lines in 230 files, the tests 26000 lines.
size: .venv/installed-test
	$(BIN)/python -m tests.size

report: .venv/installed-report
	$(BIN)/telepulse paper
	$(BIN)/telepulse study integrators

bench: .venv/installed-test
	$(BIN)/python -m benchmarks $(ARGS)

soak: .venv/installed
	$(BIN)/python -m soak $(ARGS)

fuzz: .venv/installed-fuzz
	$(BIN)/python -m fuzz $(ARGS)

docs: .venv/installed-test
	$(BIN)/python -m sphinx -W --keep-going -n -E docs out/docs

clean:
	rm -rf .venv out

.venv/bin/python:
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml constraints.txt | .venv/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[view]'
	touch $@

.venv/installed-report: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[report,bench]'
	touch $@

.venv/installed-fuzz: .venv/installed-test
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[fuzz]'
	touch $@

.venv/installed-test: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	touch $@

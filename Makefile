# Every target makes .venv when it is missing; all that is needed is Python 3.11 and make.
PYTHON ?= python3
BIN := .venv/bin
ARGS ?=

.PHONY: install demo test report bench soak fuzz docs clean

install: .venv/installed

demo: .venv/installed
	$(BIN)/telepulse demo $(ARGS)

test: .venv/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest $(ARGS)

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

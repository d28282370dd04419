# Everything runs from .venv, which is made on first use; BIN=/elsewhere/bin uses another environment.
PYTHON ?= python3.11
BIN ?= .venv/bin
DEMO ?= demo

# two threads fighting for each core make everything slower
export OMP_NUM_THREADS ?= 1

.PHONY: help install lint format test slow demo clean

help:
	@echo "make demo     render a shot with known truth, calibrate, measure, compare"
	@echo "make test     the fast tests and the doctests"
	@echo "make slow     the studies that take minutes"
	@echo "make lint     ruff and mypy"
	@echo "make format   ruff, in place"

install: $(BIN)/toolkit

# torch goes first and pinned: a looser first install may pull gigabytes of GPU libraries
.venv/bin/toolkit: pyproject.toml constraints.txt
	test -x .venv/bin/python || $(PYTHON) -m venv .venv
	.venv/bin/python -m pip install --upgrade 'pip>=25.1'
	.venv/bin/python -m pip install -c constraints.txt torch
	.venv/bin/python -m pip install -c constraints.txt --editable . --group dev
	touch $@

lint: $(BIN)/toolkit
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(BIN)/toolkit
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

test: $(BIN)/toolkit
	$(BIN)/pytest
	$(BIN)/pytest --doctest-modules toolkit calibration plugins

slow: $(BIN)/toolkit
	$(BIN)/pytest -m slow

demo: $(BIN)/toolkit
	$(BIN)/toolkit simulate --preset parabola --boards 15 --out $(DEMO)
	$(BIN)/toolkit calibrate --images $(DEMO)/boards/*.dng --out $(DEMO)/camera.toml
	$(BIN)/toolkit measure $(DEMO)/shot.dng --out $(DEMO)/measurement.json --overlay $(DEMO)/overlay.png
	$(BIN)/python examples/compare_with_truth.py $(DEMO)

clean:
	rm -rf .venv build dist demo .pytest_cache .mypy_cache .ruff_cache .hypothesis

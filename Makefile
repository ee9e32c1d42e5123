# Everything runs from one virtual environment, .venv, which `install` makes and the others call.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/installed

.PHONY: demo test check bench clean install help

help:            ## list the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 12

install: $(STAMP)  ## make .venv with everything for development

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt torch
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $(STAMP)

demo: install    ## detect on the scenes that ship, try the grasps in physics
	$(BIN)/graspmap demo --out demo

test: install    ## run the tests (two workers)
	$(BIN)/python -m pytest -n 2 -q

check: install   ## formatting, lint and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: install   ## speed against the usual tools, as ratios in one run
	$(BIN)/python -m benchmarks

clean:           ## remove what the other targets made
	rm -rf $(VENV) dist build demo bench runs .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

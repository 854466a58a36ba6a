# The first target that needs the environment sets it up, also in a fresh clone.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
READY = $(VENV)/.ready

.PHONY: demo test test-slow docs study extremes bench bench-edges bench-fit bench-lights lint dist references clean

demo: $(READY)
	$(BIN)/spheretrace demo --output spheretrace_demo
	@echo "look at spheretrace_demo/comparison.png"

test: $(READY)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

test-slow: $(READY)
	$(BIN)/python -m pytest -m slow

# the documentation, in the folder site; its notebooks are executed and share compiled programs
docs: $(READY)
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 JAX_COMPILATION_CACHE_DIR=$(CURDIR)/build/docs_cache \
	  $(BIN)/python -m mkdocs build --strict

# error against run time of the lecture's scene, in docs/study; about ten minutes
study: $(READY)
	$(BIN)/spheretrace study data/nine_spheres.txt --report docs/study

# the catalogue of extreme inputs, in docs/extremes.md
extremes: $(READY)
	$(BIN)/python tests/extremes/page.py

# run times against Mitsuba and POV-Ray; what a user of the lecture's file waits for
bench: $(READY)
	$(BIN)/python tests/bench/speed.py
	$(BIN)/python tests/bench/lecture.py

# pictures, derivatives and cost of covered edges; about twenty minutes
bench-edges: $(READY)
	$(BIN)/python tests/bench/edges.py

# time, error and recovery of fits; about an hour
bench-fit: $(READY)
	$(BIN)/python tests/bench/fit.py

# lights of photographs by Mitsuba; about five minutes
bench-lights: $(READY)
	$(BIN)/python -m pip install --quiet --editable '.[bench]'
	$(BIN)/python tests/bench/photographs.py

lint: $(READY)
	$(BIN)/python -m pip install --quiet --editable '.[lint]'
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

# wheel and sdist, checked, and the wheel tried in an empty environment
dist: $(READY)
	$(BIN)/python -m pip install --quiet --editable '.[dist]'
	rm -rf dist
	$(BIN)/python -m build --outdir dist .
	$(BIN)/twine check --strict dist/*
	$(BIN)/cffconvert --validate
	$(BIN)/python tests/wheel/try_wheel.py dist

# needs POV-Ray 3.7 (Debian: povray)
references: $(READY)
	$(BIN)/python -W ignore data/references/make_references.py
	$(BIN)/python -W ignore data/make_demo_picture.py

$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "needs Python 3.11 or later"'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	touch $@

clean:
	rm -rf $(VENV) spheretrace_demo dist site build

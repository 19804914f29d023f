# `make demo` and `make test` set up all they need in .venv; a repeated call finds it there.
PYTHON ?= python3
WORKERS ?= 2
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --no-compile -c constraints.txt
# Bytecode, once and on all cores: where PYTHONDONTWRITEBYTECODE is set, every process would compile torch again.
# Some packages ship files of other Pythons, which do not compile; they are never imported.
COMPILE := env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m compileall -qq -j 0 -x '/tests?/' $(VENV)/lib || true

.PHONY: help install demo test test-all lint notebooks docs clean

help:
	@echo "make demo     simulate an arm, infer its torques, draw them into demo/"
	@echo "make test     run the tests"
	@echo "make test-all run the longer tests"
	@echo "make lint     check style, format and types"
	@echo "make docs     build the documentation site into build/site, and check its links and pages"
	@echo "make notebooks  execute the notebooks into docs/tutorials"
	@echo "make install  everything for development into $(VENV)"
	@echo "make clean    remove $(VENV) and the demo"
	@echo "PYTHON=python3.12 chooses another interpreter (3.11 or newer) for $(VENV)."

install: $(VENV)/.development

demo: $(VENV)/.use
	$(BIN)/invdyn demo --out demo

# One thread a worker: the tests' arrays are small, and threads of several workers only get in each other's way.
# Who has nothing left takes over from the other: most of the time goes into a few rooms, whose tests come first.
test: $(VENV)/.development
	env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

# The longer ones: marked "long", or cases that a mark "quick" does not name. `.ci/run` runs them too.
test-all: $(VENV)/.development
	env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m 'long and not slow'

lint: $(VENV)/.development
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# A notebook is executed again when its text has changed.
TUTORIALS := $(patsubst notebooks/%.py,docs/tutorials/%.ipynb,$(wildcard notebooks/[0-9]*.py))
notebooks: $(TUTORIALS)

docs/tutorials/%.ipynb: notebooks/%.py | $(VENV)/.development
	$(BIN)/jupytext --quiet --to ipynb --output $@.tmp.ipynb $<
	sed -i.bak -e 's#(\.\./docs/#(../#g' -e 's#(\([0-9][0-9]_[a-z_]*\)\.py)#(\1.ipynb)#g' $@.tmp.ipynb && rm $@.tmp.ipynb.bak  # as seen from docs/tutorials
	OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(BIN)/jupyter-execute --inplace $@.tmp.ipynb
	mv $@.tmp.ipynb $@

docs: notebooks
	OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(BIN)/python -m sphinx -W --keep-going -q -b html docs build/site
	INVDYN_SITE=build/site $(BIN)/python -m pytest -q -m slow tests/front_door/test_site.py
	@echo "build/site/index.html"

clean:
	rm -rf $(VENV) demo build docs/tutorials/*.ipynb

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "invdyn needs Python 3.11 or newer, $(PYTHON) is `$(PYTHON) --version`: make PYTHON=…" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }

# Stamps: installed once, and again when what is asked for has changed.
$(VENV)/.use: pyproject.toml constraints.txt | $(BIN)/python
	@echo "Installing into $(VENV); minutes, the first time."
	$(PIP) -e '.[video]'
	@$(COMPILE)
	@touch $@

$(VENV)/.development: pyproject.toml constraints.txt | $(BIN)/python
	@echo "Installing into $(VENV); minutes, the first time."
	$(PIP) -e '.[dev,docs,robots,logs,fast,video,tracks,tracking,cameras,cluster,checkpoint]'
	@$(COMPILE)
	@touch $(VENV)/.use $@

# Everything runs in .venv, made by whatever PYTHON is (PYTHON=python3.13 make test).
PYTHON ?= python3
BIN := .venv/bin
# One stamp a Python and a set of extras; an edit of pyproject.toml installs anew.
VENV := .venv/.made-by-$(notdir $(PYTHON))
RUN := $(VENV)-run
DEV := $(VENV)-dev
# Most of the time of the tests goes into compiling: quick code does for the quick tests.
QUICKLY := XLA_FLAGS=--xla_backend_optimization_level=0
# Examples run operation by operation: what one has compiled the next ones read.
CACHED := JAX_COMPILATION_CACHE_DIR=.jax_cache JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0 \
	JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES=-1

.PHONY: reproduce reproduce-full test test-slow lint bench notebooks clean

reproduce: $(RUN) ## the main job: every study, reduced; tables, figures and a page of all under results/
	$(BIN)/jaxtrack reproduce $(STUDIES) $(if $(TRIALS),--trials $(TRIALS))

reproduce-full: $(RUN) ## the stated numbers of trials; says beforehand how long it takes
	$(BIN)/jaxtrack reproduce --full

test: $(DEV) ## everything but the slow tests, on code that is compiled quickly
	$(QUICKLY) $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow" --durations 60 tests
	$(QUICKLY) $(CACHED) $(BIN)/python -m pytest -n 2 --dist worksteal --doctest-modules jaxtrack

test-slow: $(DEV) ## all tests, the long ones too (marks on rates, memory), on code as users run it
	$(BIN)/python -m pytest -n 2 --dist worksteal tests

lint: $(DEV) ## style, types, layers, notebooks without outputs
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports
	$(BIN)/nbstripout --verify notebooks/*.ipynb

bench: $(DEV) ## ours against NumPy, the paper's times and other libraries
	$(BIN)/python benchmarks/initiators.py
	$(BIN)/python benchmarks/moments.py
	$(BIN)/python benchmarks/sonar.py
	$(BIN)/python benchmarks/trackers.py
	$(BIN)/python benchmarks/particle.py speed
	$(BIN)/python benchmarks/gradients.py
	$(BIN)/python benchmarks/studies.py

notebooks: $(DEV) ## execute every notebook, two at a time, leaving the files as they are
	printf '%s\n' notebooks/*.ipynb | xargs -P 2 -I BOOK sh -c \
		'$(BIN)/jupyter nbconvert --to notebook --execute --stdout "BOOK" > /dev/null'

clean: ## forget the environment, caches and results
	rm -rf .venv .jax_cache results

$(VENV): pyproject.toml
	$(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	touch $@

$(RUN): $(VENV)
	$(BIN)/python -m pip install --quiet -e '.[studies,plots]'
	touch $@

$(DEV): $(VENV)
	$(BIN)/python -m pip install --quiet -e '.[studies,plots,learn,export,test,dev,peers]'
	touch $@ $(RUN)

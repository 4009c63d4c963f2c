# Every target sets itself up: nothing but Python >= 3.11 and make is needed. The virtual environment
# .venv is made on first use and again when pyproject.toml changes.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/installed
INSTALLED_DEV := .venv/installed-dev
INSTALLED_DOCS := .venv/installed-docs
INSTALLED_WHEEL := .venv-wheel/installed
RECORDINGS := $(abspath $(wildcard ../shared/recordings))
# Installs into an environment: by its own pip, or by uv, which takes a third of the time and which
# .ci/run names.
install = $(if $(UV),$(UV) pip install --python $(1)/bin/python,$(1)/bin/python -m pip install) --quiet
WORKERS ?= auto
PARALLEL := --numprocesses=$(WORKERS) --dist=loadfile --no-loadscope-reorder
# Which tests `make test` runs; `make test-all` and .ci/run leave out only long repetitions.
MARKS ?= not slow and not long

# What tells in a few minutes whether another environment will do: every library is asked for
# something here. ARGS=tests runs all.
SELECTION := tests/rig tests/io tests/data tests/compilation tests/physics/test_twin.py \
    tests/simulation/test_simulate.py \
    tests/simulation/test_solvers.py::test_kvaerno5_gives_the_same_on_the_paper_s_circuit \
    tests/matching/test_at_bounds.py tests/matching/test_levenberg_marquardt.py \
    tests/sensitivity_analysis/test_correlation_coefficients.py tests/sweeps/test_store.py tests/sweeps/test_open.py \
    tests/plots/test_plate_map.py tests/live/test_framing.py tests/live/test_recorder.py \
    tests/live/test_mqtt.py tests/test_doctor.py tests/test_package.py
NEWEST ?= $(firstword $(shell for python in python3.13 \
    "$${PYENV_ROOT:-$$HOME/.pyenv}"/versions/3.13.*/bin/python; do \
    "$$python" -c pass 2>/dev/null && echo "$$python"; done))

.PHONY: help bench bench-gpu hazards demo docs laws test test-slow test-all test-long test-lowest test-newest lint types lab notebook notebook-check pictures wheel-check clean

help:
	@echo "make demo         simulate, match and analyse the paper's rig; writes report/index.html"
	@echo "make test         the tests to run before a commit; ARGS='-k rig' picks some"
	@echo "make test-slow    those that take longer; test-all runs both"
	@echo "make test-long    repetitions: more rigs, solvers and kills than test-all"
	@echo "make lint         ruff: rules and layout"
	@echo "make types        pyright"
	@echo "make notebook     run the notebooks again, in place; notebook-check runs them from the wheel"
	@echo "make lab          open the notebooks in JupyterLab; ARGS=--no-browser on a server"
	@echo "make docs         build the documentation site, build/site/index.html, and check its links"
	@echo "make laws         write the laws of heat as C and SPICE again, from those in Python"
	@echo "make pictures     draw the pictures of the documentation again"
	@echo "make wheel-check  build sdist and wheel, check both, and use the wheel from a fresh environment"
	@echo "make test-lowest  a selection on the oldest libraries that pyproject.toml allows"
	@echo "make test-newest  the selection on Python 3.13, where it is installed"
	@echo "make bench        measure beside other tools; ARGS=--quick is small"
	@echo "make bench-gpu    draws a second on an NVIDIA accelerator, in ten minutes"
	@echo "make hazards      every hazard of a heater on a virtual rig, 20 times: is it off in time?"
	@echo "make clean        remove what the other targets made"

demo: $(INSTALLED)
	$(BIN)/jaxtwin demo --out report

# Each processor has a process of its own, and threads of OpenBLAS would wait for each other.
test test-lowest test-newest: export OPENBLAS_NUM_THREADS ?= 1

test: $(INSTALLED_DEV)
	$(BIN)/python -m pytest $(PARALLEL) -m "$(MARKS)" $(ARGS)

test-slow:
	$(MAKE) test MARKS="slow and not long"

test-all:
	$(MAKE) test MARKS="not long"

# More rigs, solvers and kills of what the other tests check already.
test-long:
	$(MAKE) test MARKS=long

lint: $(INSTALLED_DEV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(INSTALLED_DEV)
	$(BIN)/pyright

lab: $(INSTALLED)
	$(call install,.venv) --editable '.[lab]'
	$(BIN)/jupyter lab --LabApp.default_url=/lab/tree/notebooks $(ARGS)

notebook: $(INSTALLED_DEV)
	$(BIN)/jupyter nbconvert --to notebook --execute --inplace notebooks/*.ipynb
	$(BIN)/python docs/tidy_notebooks.py notebooks/*.ipynb

# As users run them: a copy outside the checkout, by the installed wheel, which does not look for
# recordings beside the checkout. Compiled without most of XLA's optimisations, as `make test` does,
# each takes less time in all, and prints the same numbers where no clock has a part in them.
notebook-check: export JAX_DISABLE_MOST_OPTIMIZATIONS ?= 1
notebook-check: export XLA_FLAGS ?= --xla_cpu_parallel_codegen_split_count=1
notebook-check: $(INSTALLED_WHEEL)
	$(call install,.venv-wheel) "$$(echo dist/*.whl)[notebook,storage,tclab,widgets]"
	set -e; made=$$(mktemp -d); trap 'rm -rf "$$made"' EXIT; \
	$(if $(RECORDINGS),export JAXTWIN_RECORDINGS="$${JAXTWIN_RECORDINGS:-$(RECORDINGS)}"; )\
	for notebook in notebooks/*.ipynb; do \
	    cp "$$notebook" "$$made"; copy=$$made/$${notebook##*/}; start=$$(date +%s); \
	    .venv-wheel/bin/jupyter nbconvert --to notebook --execute --inplace "$$copy"; \
	    echo "$$notebook: $$(($$(date +%s) - start)) s"; \
	done

# Warnings are errors.
docs: $(INSTALLED_DOCS)
	$(BIN)/python -m docs.site

pictures: $(INSTALLED)
	$(BIN)/python docs/make_gallery.py
	$(BIN)/python docs/make_pictures.py

laws: $(INSTALLED)
	$(BIN)/python -m jaxtwin.physics._make_laws

# The wheel must carry the data files as they are, and need nothing but what it names: it is installed
# in an empty environment and used from outside the checkout. `twine check` renders the README.
wheel-check:
	rm -f $(INSTALLED_WHEEL)
	$(MAKE) $(INSTALLED_WHEEL)
	$(BIN)/python -m twine check --strict dist/*
	set -e; fresh=$$(mktemp -d); trap 'rm -rf "$$fresh"' EXIT; \
	checkout=$$PWD; wheel=$$PWD/.venv-wheel/bin; cd "$$fresh"; \
	$$wheel/jaxtwin rigs; \
	$$wheel/python -c 'import jaxtwin.data; print(jaxtwin.data.table(4).title)'; \
	diff --recursive --exclude='.*' "$$checkout/data" \
	    "$$($$wheel/python -c 'import jaxtwin.data; print(jaxtwin.data.data_folder())')"

# In about ten minutes on two processors; ARGS="--healthy 1000" runs hours without a hazard.
hazards: $(INSTALLED)
	$(BIN)/python -m benchmarks.live_hazards $(ARGS)

bench: $(INSTALLED)
	$(call install,.venv) --editable '.[bench]'
	$(BIN)/python -m benchmarks.compare $(ARGS)

# Nothing but jaxtwin and JAX for CUDA 12, which comes as wheels; ARGS=--quick is small.
bench-gpu: $(INSTALLED)
	$(call install,.venv) --editable '.[cuda]'
	$(BIN)/python -m benchmarks.gpu $(ARGS)

# Only direct requirements are at their lower bounds. The newest libraries below them deprecate what
# these old ones use: such warnings are no errors here.
test-lowest:
	$(PYTHON) -m venv .venv-lowest
	$(if $(UV),,.venv-lowest/bin/python -m pip install --quiet uv)
	$(or $(UV),.venv-lowest/bin/uv) pip install --python .venv-lowest/bin/python \
	    --resolution lowest-direct --editable '.[dev]'
	.venv-lowest/bin/python -m pytest $(PARALLEL) -m "not slow and not long" -W default::DeprecationWarning \
	    $(or $(ARGS),$(SELECTION))

test-newest:
ifeq ($(NEWEST),)
	@echo "Python 3.13 is not installed: the tests do not run on it (make NEWEST=/path/to/python3.13)"
else
	$(NEWEST) -m venv .venv-newest
	$(call install,.venv-newest) --editable '.[dev]'
	.venv-newest/bin/python -m pytest $(PARALLEL) -m "not slow and not long" $(or $(ARGS),$(SELECTION))
endif

clean:
	rm -rf .venv .venv-lowest .venv-newest .venv-wheel build dist report .pytest_cache .ruff_cache .hypothesis .jax_cache

$(INSTALLED): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "jaxtwin needs Python 3.11 or newer; name one: make PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	$(call install,.venv) --editable .
	@touch $@

$(INSTALLED_DEV): $(INSTALLED)
	$(call install,.venv) --editable '.[dev]'
	@touch $@

$(INSTALLED_DOCS): $(INSTALLED)
	$(call install,.venv) --editable '.[docs]'
	@touch $@

# The wheel is built from the source distribution, which shows that nothing is missing in that either.
$(INSTALLED_WHEEL): $(INSTALLED_DEV) $(shell find src data -type f -not -path '*/__pycache__/*') README.md
	rm -rf dist .venv-wheel
	$(BIN)/python -m build .
	$(PYTHON) -m venv .venv-wheel
	$(call install,.venv-wheel) dist/*.whl
	@touch $@

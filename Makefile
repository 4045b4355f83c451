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
TESTS  := $(BIN)/python -m pytest -p tools.again_alone -n $(JOBS) --dist loadgroup
# Small matrices: on a busy machine, threads that wait for each other are ten times slower than one.
export OPENBLAS_NUM_THREADS ?= 1
# Without what Python and pytest keep of a module, each worker of pytest would rewrite all tests once more: 8 s of CPU.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help accuracy fault-to-page run check test compiled collected test-laws test-laws-compiled test-laws-checked test-laws-plain thorough test-system test-vm lint bench mutation check-budget check-preview check-learning soak-machine soak-kill soak-recording soak-watched surprise fault-campaign fuzz-socket fuzz-udp fuzz-ethercat fuzz-workers robustness counterfactual docs site tune clean check-coupling check-tooth

help:             ## this list
	@grep -hE '^[a-z-]+: .*##|^[a-z-]+:  *##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 16

$(BASE): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed, found $$($(PYTHON) -V)"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { echo "the module venv is missing: apt-get install python3-venv"; exit 1; }
	$(PIP) --editable .
	@touch $(BASE)

$(READY): $(BASE)
	$(PIP) --editable '.[dev]'
	# its client wants an older paho-mqtt; its decoder, which the tests hold ours against, wants none
	$(PIP) --no-deps pysparkplug
	@touch $(READY)

run: $(BASE)     ## the paper's experiment, then 10 s of the real loop at 10 kHz on the simulated cell
	@$(BIN)/python -m tools.compiled run  # by one process, which types each law once; the two would do it twice
	$(BIN)/micromanip evaluate config/simulated.yaml --out out/evaluate
	$(BIN)/micromanip run config/simulated.yaml --duration 10 --socket out/control.sock

lint: $(READY)    ## style, types, who may import whom
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

check: lint       ## for every commit: lint, and the tests that neither wait for processes and links nor compute for long
	$(TESTS) -n $(shell nproc) -m 'not live and not long and not thorough' tests

test: $(READY)    ## lint and all tests; the laws compiled, bounds-checked and as plain Python
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target test-laws-compiled lint test-laws-plain test-laws-checked collected
	$(TESTS) -m 'not thorough' tests --ignore=tests/rt

compiled: $(READY)  # by one process, which types each law once; each worker of pytest would do the same
	@$(BIN)/python -m tools.compiled

collected: $(READY)  # what pytest makes of a new or changed test is kept; each worker would make the same. Errors: later
	@$(BIN)/pytest --collect-only -qqq tests --ignore=tests/rt >/dev/null || true

test-laws: $(READY) ## the tests of the laws compiled, with bounds checks, and as plain Python
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target test-laws-compiled test-laws-plain test-laws-checked

test-laws-compiled: compiled  # by one process, too
	$(BIN)/pytest tests/rt

test-laws-checked: $(READY)  # optimised little: it is compiled once and runs shortly
	NUMBA_BOUNDSCHECK=1 NUMBA_OPT=1 $(BIN)/pytest tests/rt -m 'not compiled_only'

test-laws-plain: $(READY)
	NUMBA_DISABLE_JIT=1 $(BIN)/pytest tests/rt -m 'not compiled_only and not many_cycles'

thorough: $(READY) ## what `make test` has fewer of: 60 examples of each search of hypothesis, further cells, plants, kills and pages
	$(TESTS) --hypothesis-profile=thorough -m 'hypothesis or thorough' tests
	NUMBA_DISABLE_JIT=1 $(BIN)/pytest --hypothesis-profile=thorough -m '(hypothesis or many_cycles) and not compiled_only' tests/rt

test-system: $(READY) ## the service under a real systemd, on a throw-away copy of this machine; takes root
	tools/system-tests/scenarios.sh namespace

test-vm: $(READY) ## the same, and SocketCAN, on a PREEMPT_RT kernel in an emulated machine; takes root, fetches 90 MB of Debian
	tools/system-tests/scenarios.sh vm

bench: $(READY)   ## speed beside references measured in the same run
	$(BIN)/micromanip bench

check-budget: $(READY) ## the error budget beside virtual experiments with causes switched off, on five cells
	$(BIN)/python -m tools.check_budget

accuracy: $(READY) ## what the cell reaches beside paper and bound, on drawn plants too; writes docs/accuracy.md (half an hour)
	$(BIN)/python -m tools.accuracy

check-preview: $(READY) ## previews of 60 drawn paths beside the same paths played in virtual time
	$(BIN)/python -m tools.check_preview

check-coupling: $(READY) ## path errors with coupling ignored, decoupled and not there, beside what is predicted of it
	$(BIN)/python -m tools.check_coupling

check-tooth: $(READY) ## path errors where the spindle turns at another speed than was said, fixed and followed, on drawn plants too
	$(BIN)/python -m tools.check_tooth

check-learning: $(READY) ## five identical parts, learned from one to the next, on 10 cells with drawn plants
	$(BIN)/python -m tools.check_learning

mutation: compiled ## every mutant of the last gates and of the fault manager must die; the laws' as plain Python
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m tools.mutation micromanip.rt.laws.limiter micromanip.rt.faults
	$(BIN)/python -m tools.mutation micromanip.bus.safe_state micromanip.host.safe.outputs micromanip.host.safe.bus_rest

fuzz-socket: $(READY) ## a million lines of garbage against the control socket
	$(BIN)/pytest tests/host/test_garbage.py --garbage 1000000

fuzz-udp: $(READY)  ## ten million datagrams of garbage against the driver udp
	$(BIN)/pytest -n0 --timeout=3600 tests/drivers/udp -k garbage --garbage 500000

fuzz-ethercat: $(READY) ## a million frames, mails and ESI files of nobody against master, slaves and readers, with bounds checks
	NUMBA_BOUNDSCHECK=1 $(BIN)/pytest -n0 --timeout=7200 tests/drivers/ethercat/test_garbage.py --garbage 1000000

fuzz-workers: $(READY) ## a million frames and packets of nobody at the compiled halves of canopen and stream, with bounds checks
	NUMBA_BOUNDSCHECK=1 $(BIN)/pytest -n0 --timeout=7200 tests/drivers/canopen/test_garbage.py tests/drivers/line/test_garbage.py --garbage 1000000

soak-machine: $(READY) ## ten thousand steps of commands, faults, lines and swaps on the cell
	$(BIN)/pytest -n0 --hypothesis-profile=soak tests/rt/test_cell_machine.py

fault-campaign: $(READY) ## faults of a bus on the whole daemon and a simulated device; writes docs/fault-campaign.md
	$(BIN)/python -m tools.bus_faults --write

soak-kill: $(READY) ## kill -9 of each process in turn, a hundred times at random moments
	$(BIN)/python -m tools.kills

soak-watched: $(READY) ## ten minutes recorded in full, with scopes, metrics, OPC UA and a set each second; the loop beside without
	$(BIN)/python -m tools.watched_soak

fault-to-page: $(READY) ## how long after its cycle a fault is read in a browser, forty times
	$(BIN)/python -m tools.fault_to_page

soak-recording: $(READY) ## a recorder killed a hundred times, its file read each time; 5 million values a second recorded
	$(BIN)/pytest -n0 --kills 100 tests/host/test_mcap_recording.py
	$(BIN)/python -m tools.record_soak

surprise: $(READY) ## a thousand interleavings of commands, kills, stops, cuts and bad files on one device: does it ever jump?
	$(BIN)/python -m tools.surprise

robustness: $(READY) ## commission 100 cells with drawn plants, and hold their true margins against the claimed ones
	$(BIN)/python -m tools.robustness

counterfactual: $(READY) ## predictions of 20 drawn tunings on a simulated recording, beside their true re-simulation
	$(BIN)/python -m tools.counterfactual

tune: $(READY)    ## commission config/factory.yaml, and put the result into the tuned configurations
	$(BIN)/python -m tools.tune

docs: $(READY)    ## generated pages and pictures
	$(BIN)/python -m micromanip.settings.documents.configuration_page > docs/configuration.md
	$(BIN)/python -m micromanip.settings.documents.drivers_page > docs/driver-options.md
	$(BIN)/python -m micromanip.settings.documents.faults_page > docs/faults.md
	$(BIN)/python -m tools.pictures
	$(BIN)/python -m tools.pictures.identification

site: $(READY)    ## the manual as a site to search, in out/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

clean:            ## remove what the targets above made
	rm -rf $(VENV) out .hypothesis .mypy_cache .ruff_cache

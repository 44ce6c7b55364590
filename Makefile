# Works on a machine with Python 3.11 and make only. The first target that needs the environment builds it in .venv.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
READY := .venv/.ready
KERNELS := .venv/.kernels
# Text that is made from the contract and that git does not hold: types of the client and pages of the reference.
MADE := .venv/.made
IMAGE ?= kilter
# Forks that share the tests, module by module, in the order of tests/conftest.py: the long ones first. Many wait for another
# process, or for a clock: with four of them on two cores a quarter of the time of these was idle.
TESTERS ?= 6
SHARED := --testers $(TESTERS)
# Small fits gain nothing from threads of the linear algebra library and lose tenfold to them on two busy cores.
export OPENBLAS_NUM_THREADS ?= 1
# Where compiled modules may not be kept, each process of a test would compile anew all that it imports.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: $(shell sed -n 's/^\([a-z-]*\):.*## .*/\1/p' $(MAKEFILE_LIST))

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 16

setup: $(READY) $(KERNELS) $(MADE) ## build .venv with pinned dependencies (done once, again when a dependency list changes)

$(READY): pyproject.toml core/pyproject.toml clients/files/pyproject.toml clients/python/pyproject.toml constraints.txt tools/make_environment.sh
	sh tools/make_environment.sh "$(PYTHON)"
	touch $@

$(KERNELS): $(READY) $(wildcard core/kilter_core/*/kernels/*.py) service/kilter_service/stream/corrector/fast_path.py service/kilter_service/run/compiling.py
	$(BIN)/kilterd compile
	touch $@

MADE_FROM := $(shell find tools/contract clients/python/src docs/reference -name '*.py' -o -name '*.in')
$(MADE): $(KERNELS) tests/contract/openapi.txt $(MADE_FROM)
	$(BIN)/python -m tools.contract --made
	touch $@

demo: $(KERNELS) ## calibrate a simulated Katana 450 from measured poses to corrected setpoints
	$(BIN)/python -m tools.demo

serve: $(KERNELS) ## run the server on this machine until Ctrl-C
	$(BIN)/kilterd serve

# The numeric part also runs under the linear algebra of another kind of processor: what is found must not depend on it.
OTHER_CORE ?= Sandybridge
OTHER_CORE_TESTS := tests/core/identify/test_identify.py tests/core/identify/test_identifiability.py tests/core/identify/test_valley.py \
	tests/core/measurement/test_contacts.py tests/core/measurement/test_distances.py tests/core/procedures

# What make check runs, and what a run of all tests leaves out where it has just been green (CHECKED=1).
CHECK_TESTS := tests/contract/test_layout.py tests/contract/test_docs.py tests/contract/test_openapi.py
DONE_BY_CHECK := $(addprefix --ignore=,$(CHECK_TESTS)) \
	--deselect=tests/contract/test_options.py::test_the_contract_of_effects_is_up_to_date

test: $(MADE) ## run the tests, the numeric part also under another kind of processor (OTHER_CORE=Sandybridge, LONG=1 for all)
	@$(MAKE) --no-print-directory --jobs=2 test-other-core test-here

# Beside the others: by itself it left a core idle. It says how it ended, and all else where it failed.
test-other-core: $(MADE) ## of make test, the numeric part under another kind of processor (OTHER_CORE=Sandybridge)
	@mkdir -p build
	@OPENBLAS_CORETYPE=$(OTHER_CORE) $(BIN)/python -m pytest -q $(OTHER_CORE_TESTS) >build/other-core.txt 2>&1 \
		|| { cat build/other-core.txt; exit 1; }
	@echo "under $(OTHER_CORE): $$(tail -n 1 build/other-core.txt)"

test-here: $(MADE) ## of make test, all tests as this machine computes (LONG=1 for the long ones too)
	$(BIN)/python -m pytest $(if $(LONG),-m "not slow and not bench") $(SHARED) $(if $(SLOWEST),--durations=$(SLOWEST)) $(if $(CHECKED),$(DONE_BY_CHECK))

test-long: $(MADE) ## run the tests that only the gate runs, by make test LONG=1: those that take longest (tests/seconds.txt)
	$(BIN)/python -m pytest -m "long and not slow and not bench" $(SHARED)

# While one area changes: its own tests. Each folder of tests is in one of these or in test-page.
CORE_TESTS := tests/core tests/blind tests/frozen tests/thesis tests/mix_ups
SERVER_TESTS := tests/service tests/fuzz
STREAM_TESTS := tests/corrector
CLIENTS_TESTS := tests/clients tests/contract

test-core: $(MADE) ## of the tests, those of the numeric part
	$(BIN)/python -m pytest -q $(SHARED) $(CORE_TESTS)

test-server: $(MADE) ## of the tests, those of the server
	$(BIN)/python -m pytest -q $(SHARED) $(SERVER_TESTS)

test-stream: $(MADE) ## of the tests, those of the corrector and what streams through it
	$(BIN)/python -m pytest -q $(SHARED) $(STREAM_TESTS)

test-clients: $(MADE) ## of the tests, those of the command, the library, the file readers, the contract and the docs
	$(BIN)/python -m pytest -q $(SHARED) $(CLIENTS_TESTS)

test-cpu: $(MADE) ## measure the processor time of each test, whatever else the machine does, and write tests/seconds.txt
	$(BIN)/python -m pytest -q -m "not slow and not bench" --cpu --write-cpu $(SHARED)

test-processors: $(KERNELS) ## fit N campaigns of every kind of measurement under four kinds of processor and compare (N=1000)
	$(BIN)/python -m tests.core.processors.compared --n $(or $(N),1000)

test-pythons: $(READY) ## run the quick part of the tests on every supported Python that is here (VERSIONS="3.12 oldest")
	sh tools/test_pythons.sh $(VERSIONS)

wheels: $(READY) ## build all wheels into dist/, install them in a fresh environment and try them there
	sh tools/make_wheels.sh "$(PYTHON)"

test-wheels: ## run the suite from the installed wheels (TESTS="tests/core ..."), after make wheels
	sh tools/test_wheels.sh $(TESTS)

# The kernels run compiled, where no line is counted: their tests run once more without the compiler. Then numpy warns of
# overflows that the compiled code passes over, as it should: a rotation by an infinite cotangent is by nothing.
KERNEL_TESTS := tests/core/arm/test_chain.py tests/core/arm/test_moments.py tests/core/observations/test_poses.py tests/corrector/test_kernel.py \
	tests/corrector/test_load_chain.py

coverage: $(MADE) ## count the lines that the tests run, those of the kernels without the compiler (slow)
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest $(SHARED)
	NUMBA_DISABLE_JIT=1 $(BIN)/coverage run -m pytest -q -W ignore::RuntimeWarning $(KERNEL_TESTS)
	$(BIN)/coverage combine -q
	$(BIN)/coverage report

check: check-types check-rest ## style, types, import rules (make --jobs=2 check: both parts at once)

check-types: $(READY) ## the first part of make check: style and types
	$(BIN)/python -m tools.contract.client
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# It imports the core: before its kernels are compiled it would compile them itself.
check-rest: $(MADE) ## the second part of make check: imports, what is generated, the shape of the repository
	$(BIN)/lint-imports
	$(BIN)/python -m tools.contract --check
	$(BIN)/python -m tools.draw_rooms --check
	$(BIN)/python -m tools.licences --check
	$(BIN)/python -m tools.bundle_page --check
	$(BIN)/python -m tools.c_corrector --check
	$(BIN)/python -m pytest -q -m "not slow" $(CHECK_TESTS)

page: $(READY) ## bundle the page's scripts and styles (needs Node.js, for whoever changes the page only)
	$(BIN)/python -m tools.bundle_page

c-corrector: $(READY) ## translate the kernels of the correction into clients/c
	$(BIN)/python -m tools.c_corrector

parity-c: $(KERNELS) ## send N random setpoints through the C corrector and the compiled kernels, and compare (N=10000000)
	$(BIN)/python -m tests.core.correct.parity --count $(or $(N),10000000)

FUZZED := -g -O1 -fsanitize=fuzzer,address,undefined,float-cast-overflow -fno-sanitize-recover=all
fuzz-c: $(KERNELS) ## let libFuzzer damage programs and setpoints of the C corrector (MINUTES=30; needs clang with its runtime)
	mkdir -p build/fuzz-c
	$(BIN)/python -m tests.core.correct.fuzz_seeds build/fuzz-c/inputs
	clang -std=c99 -Wall -Wextra $(FUZZED) -Iclients/c -o build/fuzz-c/fuzz tests/core/correct/fuzz.c clients/c/kilter_corrector.c -lm
	build/fuzz-c/fuzz -max_total_time=$$((60 * $(or $(MINUTES),30))) -timeout=30 -max_len=20000 -artifact_prefix=build/fuzz-c/ build/fuzz-c/inputs

page-picture: $(KERNELS) ## draw docs/images/page.png from the page of a server with demo data (VIEW=/stream; needs Chromium)
	$(BIN)/python -m tools.draw_page_picture $(if $(VIEW),--view $(VIEW))

rooms: $(READY) ## draw the rooms of the packages and their tables from the imports
	$(BIN)/python -m tools.draw_rooms

licences: $(READY) ## list the licences of what is needed at run time
	$(BIN)/python -m tools.licences

contract: $(KERNELS) ## write anew what repeats the contract: the interface, its types, tables, help and pages
	$(BIN)/python -m tools.contract

bench: $(KERNELS) ## measure speed against other tools and print the ratios
	$(BIN)/python -m benchmarks.core
	$(BIN)/python -m benchmarks.gap --quick
	$(BIN)/python -m benchmarks.camera
	$(BIN)/python -m benchmarks.lerobot

bench-gap: $(KERNELS) ## time gap hunts: 118 and 10 000 poses, and a motion at 4600 Hz
	$(BIN)/python -m benchmarks.gap

bench-peers: .venv-peers/.ready .venv-peers-poe/.ready ## install the tools that make bench compares with, apart from Kilter

# pybotics states numpy below 2 and FIGAROH needs 2; pybotics runs with either, so it is installed without its list.
.venv-peers/.ready: benchmarks/peers-constraints.txt
	[ -x .venv-peers/bin/python ] || "$(PYTHON)" -m venv .venv-peers
	.venv-peers/bin/pip install --disable-pip-version-check -q --constraint benchmarks/peers-constraints.txt figaroh attrs scipy
	.venv-peers/bin/pip install --disable-pip-version-check -q --constraint benchmarks/peers-constraints.txt --no-deps pybotics
	touch $@

# robotkinecal needs numpy below 2.
.venv-peers-poe/.ready: benchmarks/peers-poe-constraints.txt
	[ -x .venv-peers-poe/bin/python ] || "$(PYTHON)" -m venv .venv-peers-poe
	.venv-peers-poe/bin/pip install --disable-pip-version-check -q --constraint benchmarks/peers-poe-constraints.txt robotkinecal
	touch $@

challenge: $(KERNELS) ## search cases that somebody else hid and score them against the sealed truth (DIR=cases)
	@[ -n "$(DIR)" ] || { echo 'Name the folder of cases: make challenge DIR=cases (docs/how-to/hide-a-case.md)'; exit 2; }
	$(BIN)/python -m benchmarks.challenge "$(DIR)"

bench-c: $(KERNELS) ## time the corrector in C for each setpoint in process, memory locked, up to the slowest (COUNT=3000000 PRIORITY=50)
	$(BIN)/python -m benchmarks.c_corrector --count $(or $(COUNT),3000000) $(if $(PRIORITY),--priority $(PRIORITY))

bench-stream: $(KERNELS) ## compare the corrected stream with a bare zenoh echo, in one run (TLS=1: signed, both with TLS)
	$(BIN)/python -m benchmarks.stream $(if $(TLS),--tls)

bench-rsi: $(KERNELS) ## ask a bridge for offsets as a KUKA controller does, and count late answers (CYCLES=150000 CYCLE_MS=4 PRIORITY=40 STRANGERS=2000)
	$(if $(PRIORITY),PRIORITY=$(PRIORITY)) $(BIN)/python -m tests.clients.bridges.long_run --cycles $(or $(CYCLES),150000) --cycle-ms $(or $(CYCLE_MS),4) --strangers $(or $(STRANGERS),0)

test-franka: $(KERNELS) .venv-franka/.ready ## move a simulated Franka robot through a bridge, its limits enforced (SECONDS=16 PRIORITY=40 LATE=drop)
	KILTER_FRANKA=.venv-franka $(if $(LATE),LATE=$(LATE)) $(if $(SECONDS),SECONDS=$(SECONDS)) $(if $(PRIORITY),PRIORITY=$(PRIORITY)) $(BIN)/python -m pytest -q -s --timeout 1800 tests/clients/bridges/test_fci_bridge.py

test-linuxcnc: $(KERNELS) ## move a calibrated arm in LinuxCNC's own simulation (Debian: apt-get install linuxcnc-uspace-dev)
	$(BIN)/python -m pytest -m slow -q -rs tests/clients/linuxcnc

# The simulator needs numpy below 2, so it has an environment of its own; the bridge gets the robot's library alone.
FRANKA_PINS := tests/clients/bridges/franka-constraints.txt
.venv-franka/.ready: $(FRANKA_PINS)
	[ -x .venv-franka/bin/python ] || "$(PYTHON)" -m venv .venv-franka
	.venv-franka/bin/pip install --disable-pip-version-check -q --constraint $(FRANKA_PINS) franka-sim pylibfranka
	.venv-franka/bin/pip install --disable-pip-version-check -q --upgrade --no-deps --target .venv-franka/bridge --constraint $(FRANKA_PINS) pylibfranka
	touch $@

test-lerobot: $(KERNELS) .venv-lerobot/.ready ## run LeRobot's own follower through Kilter on simulated servos (needs Python 3.12, 5 GB)
	KILTER_LEROBOT=.venv-lerobot $(BIN)/python -m pytest -q --timeout 1800 tests/clients/lerobot

test-kit: $(KERNELS) ## ask kilter kit about simulated SO-101s, slow: N worn and N clean, 10 s each; goes on where it was (N=200 SEED=0 RECORDS=build/many-arms-0.jsonl)
	$(BIN)/python -m tests.clients.lerobot.many_arms --n $(or $(N),200) --seed $(or $(SEED),0) $(if $(RECORDS),--records $(RECORDS))

# LeRobot needs Python 3.12 and brings PyTorch: an environment of its own, with Kilter's distributions as they are here.
LEROBOT_PINS := tests/clients/lerobot/constraints.txt
.venv-lerobot/.ready: $(LEROBOT_PINS) clients/lerobot/pyproject.toml
	sh tools/lerobot_environment.sh $(LEROBOT_PINS)
	touch $@

bench-watched: $(KERNELS) ## measure the stream with and without an open page, in turns (SECONDS=60)
	$(BIN)/python -m benchmarks.stream_watched --seconds $(or $(SECONDS),60)

bench-drift: $(KERNELS) ## watch simulated arms day after day and print one page: false alarms, steps, causes, ramps, seasons (ROBOTS=1000 DAYS=250 FIRST=0)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.drift --robots $(or $(ROBOTS),1000) --days $(or $(DAYS),250) --first $(or $(FIRST),0)

bench-drift-sums: ## draw a million checks of arms that do not move and print how rarely the sums begin to alarm
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.drift_sums

bench-fleet: $(KERNELS) ## identify simulated arms of a type from a few poses with the prior of the others, each left out once (TYPES=4 ROBOTS=12)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.fleet --types $(or $(TYPES),4) --robots $(or $(ROBOTS),12)

bench-page: $(KERNELS) ## measure the page: the first view, memory over LOADS=1000 of them, a campaign of a million rows
	$(BIN)/python -m benchmarks.page --loads $(or $(LOADS),1000)

bench-beside: $(KERNELS) ## measure the kernels beside those of another commit, in turns (BASE=HEAD~1 ROUNDS=5)
	sh tools/bench_beside.sh $(or $(BASE),HEAD~1) $(or $(ROUNDS),5)

load: $(KERNELS) ## put a whole server under load on SQLite and PostgreSQL: clients, probe, followers, memory, a million rows (MINUTES=5)
	$(BIN)/python -m benchmarks.load --minutes $(or $(MINUTES),5)

fuzz: $(KERNELS) ## send 20 000 requests of every kind to the HTTP interface, 2 000 of them on PostgreSQL too (CASES=20000 PG_CASES=2000 SEED=0)
	$(BIN)/python -W ignore::RuntimeWarning -m tests.fuzz.run --cases $(or $(CASES),20000) --postgresql $(or $(PG_CASES),2000) --seed $(or $(SEED),0)

fuzz-stream: $(KERNELS) ## send a million damaged frames through the corrector
	$(BIN)/python -m pytest -m slow -q tests/corrector/test_stream.py

attack-stream: $(KERNELS) ## send a million forged, replayed and damaged messages to a stream, 200 000 of them over zenoh
	$(BIN)/python -m pytest -m "slow or not slow" -q -s tests/corrector/test_signed.py tests/corrector/test_attacks.py tests/corrector/test_acceptance.py

soak-stream: $(KERNELS) ## stream for half an hour and watch the memory (MINUTES=30)
	$(BIN)/python -m benchmarks.stream_load soak --minutes $(or $(MINUTES),30)

test-faults: $(KERNELS) ## kill, stop and cut off everything around the stream, slow cases too
	$(BIN)/python -m pytest -m "slow or not slow" -q tests/corrector/test_faults.py tests/corrector/test_process.py

test-durability: $(KERNELS) ## set clocks, make disks read-only and freeze processes under a running server, slow cases too
	$(BIN)/python -m pytest -m "slow or not slow" -q tests/service/test_clock_jumps.py tests/service/test_read_only_disk.py tests/service/test_frozen.py tests/service/test_failing_disk.py \
		tests/service/test_bad_starts.py

alterations: $(KERNELS) ## flip 200 bits of a backup, alter a data folder 200 times, and print what is noticed and named
	$(BIN)/python -m pytest -m "slow or not slow" -q -s tests/service/test_seals.py tests/service/test_seal_key.py tests/service/test_schema.py tests/service/test_backup.py -k "alter or flipped or back or anew or arithmetic"

kills-stream: $(KERNELS) ## kill every process of a server in turn under a controller at 1 kHz, and print for how long it was bypassed (N=200)
	$(BIN)/python -m tests.corrector.kill_every --n $(or $(N),200)

kills: $(KERNELS) ## kill processes of a server at random while clients work, and look for what is lost (N=500 SEED=...)
	$(BIN)/python -m tests.service.kill_campaign --n $(or $(N),500) $(if $(SEED),--seed $(SEED))

test-slow: $(MADE) ## run the longer tests that make test leaves out and no other target names
	$(BIN)/python -m pytest -m slow $(SHARED) tests/core tests/contract tests/clients

test-page: $(MADE) ## run all tests of the page, the long ones too (needs Chromium; screenshots in build/page-screenshots)
	$(BIN)/python -m pytest -m "slow or not slow" -q $(SHARED) tests/page

test-many-jobs: $(KERNELS) ## run 1000 small jobs on four workers and PostgreSQL, kill two of them, and count (JOBS=1000)
	JOBS=$(or $(JOBS),1000) $(BIN)/python -m pytest -m slow -q -s tests/service/test_many_jobs.py

test-machines: $(KERNELS) ## run two APIs and two workers on PostgreSQL, and kill a worker in a fleet job
	$(BIN)/python -m pytest -m "slow or not slow" -q tests/service/test_several_machines.py

blind: $(READY) ## find hidden physics in N simulated campaigns and write docs/reference/gap-finder-benchmark.md (N=1000)
	$(BIN)/python -m tests.blind.run --n $(or $(N),1000)

blind-pairs: $(READY) ## hunt the same campaigns with right and with wrong masses (ROUNDS=3)
	$(BIN)/python -m tests.blind.pairs --rounds $(or $(ROUNDS),3)

blind-thresholds: $(READY) ## score every threshold of the gap finder at half and double (SEARCH=1: also those of the search, hours)
	$(BIN)/python -m tests.blind.thresholds --write $(if $(SEARCH),--search)

frozen: $(KERNELS) ## compare hunts, identifications and setpoints with those of another commit, bit for bit (BASE=HEAD~1 WITHIN=1e-9 CASES=100)
	sh tools/frozen.sh $(or $(BASE),HEAD~1) $(or $(WITHIN),0) $(or $(CASES),100)

thesis: $(KERNELS) ## do the thesis's experiments again on simulated arms and write their pages
	$(BIN)/python -m tools.thesis_reproduction
	$(BIN)/python -m tools.influence_and_tilting

mix-ups: $(KERNELS) ## count mix-ups that are missed and genuine campaigns that are accused (GENUINE=1000 ROUNDS=5 SEED=0)
	$(BIN)/python -m tests.mix_ups.score --genuine $(or $(GENUINE),1000) --rounds $(or $(ROUNDS),5) --seed $(or $(SEED),0)

mix-ups-ways: $(KERNELS) ## send mix-ups through upload, dry run, identify and gap of a server of its own (GENUINE=50 SEED=0)
	$(BIN)/python -m tests.mix_ups.ways --genuine $(or $(GENUINE),50) --seed $(or $(SEED),0)

silent-rows: $(KERNELS) ## count the wrong rows that pass in silence among 600 simulated recordings
	$(BIN)/python -m pytest -m slow -q tests/clients/files/match/test_silent_rows.py

image: ## build the container image (needs a container engine)
	docker build --tag $(IMAGE) .

fmt: $(READY) ## format the code and fix what can be fixed
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

clean: ## remove the environment and everything built
	rm -rf .venv dist build .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

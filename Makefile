# Works on a machine with Python 3.11 and make only. The first target that needs the environment builds it in .venv.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
READY := .venv/.ready
KERNELS := .venv/.kernels
# Text that is made from the contract and that git does not hold: types of the client and pages of the reference.
MADE := .venv/.made
IMAGE ?= kilter
# Processes that share the tests, module by module, in the order of tests/conftest.py: the long ones first. Many wait for another
# process, or for a clock: with four of them on two cores a quarter of the time of these was idle.
TESTERS ?= 6
SHARED := -n $(TESTERS) --dist loadscope --no-loadscope-reorder
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
	$(BIN)/kilter demo

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

test: $(MADE) ## run the tests, the numeric part also under another kind of processor (LONG=1 for all, TESTS=tests/core for some, SINCE=HEAD for what changes since then reach)
	@$(MAKE) --no-print-directory --jobs=2 $(if $(TESTS)$(SINCE),,.test-other-core) .test-here

# Beside the others: by itself it left a core idle. It says how it ended, and all else where it failed.
.test-other-core: $(MADE)
	@mkdir -p build
	@OPENBLAS_CORETYPE=$(OTHER_CORE) $(BIN)/python -m pytest -q $(OTHER_CORE_TESTS) >build/other-core.txt 2>&1 \
		|| { cat build/other-core.txt; exit 1; }
	@echo "under $(OTHER_CORE): $$(tail -n 1 build/other-core.txt)"

.test-here: $(MADE)
	$(BIN)/python -m pytest $(if $(LONG),-m "not slow and not bench") $(SHARED) $(if $(SLOWEST),--cpu --durations=$(SLOWEST)) $(if $(CHECKED),$(DONE_BY_CHECK)) $(if $(SINCE),--since $(SINCE)) $(TESTS)

.collected: $(MADE)
	@mkdir -p build
	@$(BIN)/python -m pytest -q --collect-only -m "not bench" >build/collected.txt 2>&1 || { cat build/collected.txt; exit 1; }
	@tail -n 1 build/collected.txt

wheels: $(READY) ## build all wheels into dist/, install them in a fresh environment and try them there
	sh tools/make_wheels.sh "$(PYTHON)"

check: .check-types .check-rest ## style, types, import rules (make --jobs=2 check: both parts at once)

.check-types: $(READY)
	$(BIN)/python -m tools.contract.client
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# It imports the core: before its kernels are compiled it would compile them itself.
.check-rest: $(MADE)
	$(BIN)/lint-imports
	$(BIN)/python -m tools.contract --check
	$(BIN)/python -m tools.draw_rooms --check
	$(BIN)/python -m tools.licences --check
	$(BIN)/python -m tools.bundle_page --check
	$(BIN)/python -m tools.c_corrector --check
	$(BIN)/python -m pytest -q -m "not slow" $(CHECK_TESTS)

page: $(READY) ## bundle the page's scripts and styles (needs Node.js, for whoever changes the page only)
	$(BIN)/python -m tools.bundle_page

contract: $(KERNELS) ## write anew what repeats the contract: the interface, its types, tables, help and pages
	$(BIN)/python -m tools.contract

bench: $(KERNELS) ## measure speed against other tools and print the ratios
	$(BIN)/python -m benchmarks.core
	$(BIN)/python -m benchmarks.gap --quick
	$(BIN)/python -m benchmarks.camera
	$(BIN)/python -m benchmarks.motion
	$(BIN)/python -m benchmarks.lerobot

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

# The simulator needs numpy below 2, so it has an environment of its own; the bridge gets the robot's library alone.
FRANKA_PINS := tests/clients/bridges/franka-constraints.txt
.venv-franka/.ready: $(FRANKA_PINS)
	[ -x .venv-franka/bin/python ] || "$(PYTHON)" -m venv .venv-franka
	.venv-franka/bin/pip install --disable-pip-version-check -q --constraint $(FRANKA_PINS) franka-sim pylibfranka
	.venv-franka/bin/pip install --disable-pip-version-check -q --upgrade --no-deps --target .venv-franka/bridge --constraint $(FRANKA_PINS) pylibfranka
	touch $@

# LeRobot needs Python 3.12 and brings PyTorch: an environment of its own, with Kilter's distributions as they are here.
LEROBOT_PINS := tests/clients/lerobot/constraints.txt
.venv-lerobot/.ready: $(LEROBOT_PINS) clients/lerobot/pyproject.toml
	sh tools/lerobot_environment.sh $(LEROBOT_PINS)
	touch $@

frozen: $(KERNELS) ## compare hunts, identifications and setpoints with those of another commit, bit for bit (BASE=HEAD~1 WITHIN=1e-9 CASES=100)
	sh tools/frozen.sh $(or $(BASE),HEAD~1) $(or $(WITHIN),0) $(or $(CASES),100)

image: ## build the container image (needs a container engine)
	docker build --tag $(IMAGE) .

fmt: $(READY) ## format the code and fix what can be fixed
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

clean: ## remove the environment and everything built
	rm -rf .venv dist build .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

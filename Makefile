# SPDX-License-Identifier: Apache-2.0
# Every target sets up what it needs; a step that is up to date is skipped. Needs make and Python 3.10 to 3.13.
# A sourced ROS 2 Jazzy is used; otherwise ROS 2 is installed as wheels into .venv (see tools/setup_env.py).

PYTHON ?= python3
DEMO_ARGS ?=
BENCH_ARGS ?=
FAULTS_ARGS ?=
COMPARE_ARGS ?=
PYTEST_ARGS ?=
# Two more than two cores: tests also wait, for discovery, for the clock, for files.
TEST_WORKERS ?= 4
TESTS = not full
DRAWS = same draws
# Without --max-worker-restart 0 a worker that crashes may end xdist with an internal error (KeyError in loadscope.py).
# Hundreds of processes import the same modules: let the first one keep what it compiles.
BYTECODE = PYTHONDONTWRITEBYTECODE=
# A file that receives pytest's exit code; make itself then succeeds (.ci/run).
TEST_STATUS ?=

VENV := $(CURDIR)/.venv$(if $(ROS_DISTRO),-ros)
SETUP = @command -v "$(PYTHON)" >/dev/null || { echo "[setup] $(PYTHON) is not there: install Python 3.10 to 3.13" >&2; exit 1; }; \
	"$(PYTHON)" "$(CURDIR)/tools/setup_env.py"
ENTER = . "$(CURDIR)/ros2_ws/install/setup.sh"
PLUGINS = -p xdist -p timeout -p hypothesispytest

# The start-up hook of the ROS wheels sets these variables, which break the Python of another environment.
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
endif

.PHONY: help demo test test-all bench faults hosts compare robots engines docs lint wheels build check clean
.DEFAULT_GOAL := help

help:  ## print this list
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' "$(firstword $(MAKEFILE_LIST))"

demo: ## run the paper's joint and a 7-joint arm on two ROS 2 nodes, record and report them in runs/ (DEMO_ARGS="...")
	$(SETUP) build
	@$(ENTER) && echo fjr demo $(DEMO_ARGS) && exec fjr demo $(DEMO_ARGS)

test: ## run the suite; the labelled bags at one strength (PYTEST_ARGS="...", TEST_WORKERS=4)
	$(SETUP) test
	@$(ENTER); PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 $(BYTECODE) "$(VENV)/bin/python" -m pytest $(PLUGINS) \
		-n $(TEST_WORKERS) --max-worker-restart 0 --dist loadfile --no-loadscope-reorder -m "$(TESTS)" \
		--hypothesis-profile "$(DRAWS)" $(PYTEST_ARGS); \
	status=$$?; [ -n "$(TEST_STATUS)" ] || exit $$status; echo $$status > "$(TEST_STATUS)"

test-all: TESTS =
test-all: DRAWS = new draws
test-all: test ## run the suite with all labelled bags, healthy starts, malformed messages, and new random draws, minutes more

bench: ## measure against Pinocchio and MuJoCo, print a table, write runs/bench.json (BENCH_ARGS="--document docs/tables/benchmarks.md")
	$(SETUP) bench
	@$(ENTER) && exec "$(VENV)/bin/python" -m bench $(BENCH_ARGS)

faults: ## inject faults into the running nodes and write docs/tables/faults.md (FAULTS_ARGS="...")
	$(SETUP) test
	@$(ENTER) && exec "$(VENV)/bin/python" -m tests.faults $(FAULTS_ARGS)

hosts: ## feed all hosts of the control step with the same states, half an hour, write docs/tables/hosts.md (HOSTS_ARGS="...")
	$(SETUP) test
	@$(ENTER) && exec "$(VENV)/bin/python" -m tests.hosts $(HOSTS_ARGS)

compare: ## compare all laws on three robots, two hours, write docs/tables/compare.md (COMPARE_ARGS="...")
	$(SETUP) build
	@$(ENTER) && for suite in paper paper_tuned arm7_tuned; do fjr compare $$suite --document $(COMPARE_ARGS) || exit $$?; done

robots: ## try `fjr new` on public robots, an hour, and write docs/tables/robots.md
	$(SETUP) test
	@$(ENTER) && "$(VENV)/bin/python" -m pip install --quiet --no-deps --constraint constraints.txt \
		--requirement requirements/robots.txt && PYTHONPATH="tools:$$PYTHONPATH" exec "$(VENV)/bin/python" -m robot_survey

engines: ## move robots by MuJoCo, by Drake and by the own plant, 15 minutes, and write docs/tables/engines.md
	$(SETUP) test
	@$(ENTER) && "$(VENV)/bin/python" -m pip install --quiet --constraint constraints.txt --requirement requirements/drake.txt && \
		"$(VENV)/bin/python" -m pip install --quiet --no-deps --constraint constraints.txt \
		--requirement requirements/robots.txt && PYTHONPATH="tools:$$PYTHONPATH" exec "$(VENV)/bin/python" -m robot_survey --engines

docs: ## build the pages and the API reference into build/docs/html; a warning is an error
	$(SETUP) docs
	@$(ENTER) && exec "$(VENV)/bin/python" tools/docs/build_docs.py

lint: ## ruff and mypy on all packages
	$(SETUP) lint
	@"$(VENV)/bin/python" -m ruff check .
	@"$(VENV)/bin/python" -m ruff format --check .
	@"$(VENV)/bin/python" -m mypy

wheels: ## build a wheel of each package, and `fjr` with all of them, into build/wheels
	$(SETUP) build
	@"$(VENV)/bin/python" tools/build_wheels.py

build: ## set up the environment and build ros2_ws (then: . ros2_ws/install/setup.sh)
	$(SETUP) build

check: ## say which Python and which ROS 2 would be used
	$(SETUP) check

clean: ## remove environments, builds and caches; runs/ stays
	rm -rf .venv .venv-ros .setup build ros2_ws/build ros2_ws/install ros2_ws/log .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find ros2_ws tests tools bench -name __pycache__ -prune -exec rm -rf {} +
	find ros2_ws -name '*.egg-info' -prune -exec rm -rf {} +

# `make demo` and `make test` need git, make and Python 3.11 or newer, nothing else.

PYTHON := .venv/bin/python
INSTALLED := .venv/.installed
DOCS_INSTALLED := .venv/.installed_docs
PYTEST := $(PYTHON) -m pytest
# The core is tested without Qt and napari: their pytest plugins would load them.
WITHOUT_GUI := -p no:pytest-qt -p no:napari -p no:npe2 -p no:napari-plugin-engine
# A module goes to one worker as a whole: what its tests share is made once.
WORKERS := -n 2 --dist loadfile

# The tests start many processes: each would compile all modules anew where this is set.
export PYTHONDONTWRITEBYTECODE :=
COVERAGE := --cov=pv_inspect --cov=napari_pv_inspect --cov-report=

.DEFAULT_GOAL := help
.PHONY: help demo tour test coverage fuzz docs lint format test-core test-plugin test-window constraints clean

help: ## say what can be made
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 15

demo: $(INSTALLED) ## run the main job on sample_data/ and open the workbench where there is a display
	@scripts/bootstrap.sh libraries $(if $(DISPLAY)$(WAYLAND_DISPLAY),window,offscreen) || true
	@$(PYTHON) benchmarks/demo.py

tour: $(INSTALLED) ## drive the workbench through a whole session, on a virtual screen; docs/tour/
	@scripts/bootstrap.sh libraries xvfb
	QT_QPA_PLATFORM=xcb LIBGL_ALWAYS_SOFTWARE=1 \
		xvfb-run -a -s "-screen 0 1600x1000x24" $(PYTHON) docs/tour.py

# One after the other, whatever -j says: the tests use all cores by themselves.
test: $(INSTALLED) ## everything that CI runs
	@scripts/bootstrap.sh libraries xvfb
	@$(MAKE) --no-print-directory lint
	@$(MAKE) --no-print-directory test-core
	@$(MAKE) --no-print-directory test-plugin
	@$(MAKE) --no-print-directory test-window

docs: $(DOCS_INSTALLED) ## build the documentation site, without warnings and network; build/site/
	$(PYTHON) -m mkdocs build --strict

fuzz: $(INSTALLED) ## every reader with 24,000 damaged and odd inputs, on two cores in some minutes
	$(PYTHON) -m benchmarks.fuzz --cases 24000 --jobs 2

lint: $(INSTALLED) ## ruff, mypy, and the floors that no import may climb
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m mypy --strict pv_inspect
	MYPYPATH=plugins $(PYTHON) -m mypy plugins/napari_pv_inspect
	.venv/bin/lint-imports --no-logo

format: $(INSTALLED) ## format all files and mend what ruff can
	$(PYTHON) -m ruff check --fix .
	$(PYTHON) -m ruff format .

test-core: $(INSTALLED) ## tests of the core; no Qt
	$(PYTEST) $(WITHOUT_GUI) --ignore=tests/plugin $(WORKERS) --durations=10

test-plugin: $(INSTALLED) ## tests of the workbench without a window
	QT_QPA_PLATFORM=offscreen $(PYTEST) tests/plugin $(WORKERS) --durations=5

# Not a part of `test`: before Python 3.12 tracing costs 40 to 60 % more processor time.
coverage: $(INSTALLED) ## the tests without a window again, and which lines of core and workbench they run
	$(PYTEST) $(WITHOUT_GUI) --ignore=tests/plugin $(WORKERS) $(COVERAGE)
	QT_QPA_PLATFORM=offscreen $(PYTEST) tests/plugin $(WORKERS) $(COVERAGE) --cov-append
	$(PYTHON) -m coverage report --skip-covered

test-window: $(INSTALLED) ## tests of the workbench in a real window, each worker on a virtual screen
ifeq ($(shell uname -s),Linux)
	QT_QPA_PLATFORM=xcb LIBGL_ALWAYS_SOFTWARE=1 $(PYTEST) tests/plugin -m xvfb -n 2 --durations=5 \
		-p xvfb -o xvfb_width=1600 -o xvfb_height=1000 -o xvfb_colordepth=24
else
	@echo "The tests in a real window need Xvfb and run on Linux only: left out."
endif

constraints: ## find the newest versions of all packages and pin them
	scripts/constraints.sh

clean: ## remove the environment and everything that was made
	rm -rf .venv demo_result fuzz_failures build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis .coverage
	find pv_inspect plugins tests benchmarks -name __pycache__ -prune -exec rm -rf {} +

$(INSTALLED): pyproject.toml constraints.txt scripts/bootstrap.sh
	@scripts/bootstrap.sh python
	@touch $@

# What the site is built with; `make test` does without.
$(DOCS_INSTALLED): $(INSTALLED)
	@scripts/bootstrap.sh docs
	@touch $@

PYTHON ?= python3
SAMPLES ?= 10000000
NOTEBOOKS := \
  tutorial \
  robot_and_terrain \
  scenario_a \
  scenario_b \
  claims \
  multiverse \
  readings_audit \
  faults \
  replay \
  explore \
  beyond \
  computation_times \
  embedded

PY := .venv/bin/python
READY := .venv/ready
EXECUTED := $(NOTEBOOKS:%=build/notebooks/%.ipynb)
RECORDS := $(EXECUTED:.ipynb=.d)

# Two notebooks at a time; several goals at once stay in the order given.
ifeq ($(words $(MAKECMDGOALS))$(filter-out figures report,$(MAKECMDGOALS)),1)
MAKEFLAGS += -j2
endif

WHAT ?=

.PHONY: help figures claims report embedded test test-browser lint replay campaign bench soak lab lock clean

help: ## list what can be made
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' Makefile

figures: $(EXECUTED) ## run the notebooks; figures and tables land in figures/
	@echo 'figures: $(if $(made),made,everything is up to date)'

claims: build/notebooks/claims.ipynb ## run the claims ledger alone: figures/claims.csv, .tex, .md and its picture

report: build/report/index.html ## run the notebooks; all of it as one site in build/report/, readable without a network
	@echo 'report: open build/report/index.html'

test: $(READY) ## run the tests
	@$(PY) -m pytest -n auto --ignore=tests/browser

test-browser: build/report/index.html ## run the tests of what the pages show, in a headless Chromium
	@$(PY) -m pytest -rs tests/browser

# The file's name reaches the shell as data, never as part of a command.
replay: export REPLAY_LOG = $(value LOG)
replay: $(READY) ## replay a recorded log: make replay LOG=file.csv; figures and tables land in build/replay/
	@test -n "$$REPLAY_LOG" || { echo 'LOG was not given; it must be a .csv or .parquet file: make replay LOG=file.csv' >&2; exit 2; }
	@$(PY) -m rhec.workbench.notebook notebooks/replay.ipynb -p log "$$REPLAY_LOG"

lint: $(READY) ## check the code's style, and that notebooks in git carry no outputs
	@$(PY) -m ruff check --quiet
	@git ls-files -z 'notebooks/*.ipynb' | xargs -0 $(PY) -m nbstripout --verify --keep-id

bench: .venv/peers ## compare computation times with other tools, some minutes; tables and pictures land in figures/
	@cd tests && ../$(PY) -m benchmark

soak: $(READY) ## drive SAMPLES samples at 5 Hz on hard ground with failing sensors, by default ten million (23 days), in some ten minutes
	@$(PY) tests/soak.py --samples $(SAMPLES)

campaign: $(READY) ## drive a thousand fields, or go on where that stopped; WHAT="-p q [1,1,1] [1,1,0] --seeds 50" says which (--help: how)
	@$(PY) -m rhec.campaigns $(WHAT)

embedded: $(READY) ## write the default scenario's estimator and controller as C into build/embedded
	@$(PY) -m rhec.codegen

# No news, no updates, no extensions from the network. Without a display, the address that it prints is to be opened elsewhere.
lab: $(READY) ## open the notebooks in JupyterLab
	@JUPYTER_CONFIG_PATH="$(CURDIR)/.jupyter:$$JUPYTER_CONFIG_PATH" $(PY) -m jupyter lab --ServerApp.preferred_dir=notebooks \
	  --LabApp.extension_manager=readonly --LabApp.news_url=None --LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate \
	  $(if $(DISPLAY)$(WAYLAND_DISPLAY)$(filter Darwin,$(shell uname)),,--no-browser) $(if $(filter 0,$(shell id -u)),--allow-root)

lock: ## pin the newest packages that pyproject.toml allows in environment.txt (needs uv)
	@command -v uv >/dev/null || { echo 'make lock needs uv on the PATH' >&2; exit 1; }
	@uv pip compile --quiet --upgrade --universal --python-version 3.11 --fork-strategy fewest \
	  --group dev --generate-hashes --no-emit-index-url --no-emit-find-links \
	  --custom-compile-command 'make lock' --output-file environment.txt pyproject.toml

clean: ## remove the executed notebooks, the figures and the tables
	@git clean -fdXq -- build figures

$(READY): environment.txt pyproject.toml
	@$(PYTHON) -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "PYTHON was $(PYTHON) ($$($(PYTHON) --version 2>&1 | head -1)); it must be Python 3.11 or newer with its venv module: make PYTHON=..." >&2; \
	  exit 1; }
	@echo "Setting up .venv with $$($(PYTHON) --version) (a minute or two the first time)"
	@$(PYTHON) -m venv .venv
	@$(PY) -m pip --disable-pip-version-check install -q --require-hashes -r environment.txt
	@$(PY) -m pip --disable-pip-version-check install -q --no-deps --no-build-isolation -e .
	@touch $@

.venv/peers: tests/benchmark/peers.txt $(READY)
	@$(PY) -m pip --disable-pip-version-check install -q --no-deps --require-hashes -r $<
	@touch $@

# The reason for a run: `$?` is what is newer than the last run, or gone.
changed = $(wildcard $?)
gone = $(filter-out $(changed),$?)
why = $(strip $(if $(changed),$(changed) changed) $(if $(gone),$(if $(changed),and) $(gone) $(if $(word 2,$(gone)),are,is) gone))

$(EXECUTED): build/notebooks/%.ipynb: notebooks/%.ipynb build/notebooks/%.d environment.txt | $(READY)
	@echo '$*: $(if $(wildcard $@),made again because $(why),made for the first time)'
	@$(PY) -m rhec.workbench.notebook $<
	$(eval made := yes)

# They measure time, so they run alone.
build/notebooks/computation_times.ipynb: | $(filter-out %/computation_times.ipynb %/embedded.ipynb,$(EXECUTED))
build/notebooks/embedded.ipynb: | $(filter-out %/embedded.ipynb,$(EXECUTED))

build/report/index.html: $(EXECUTED) rhec/workbench/report.py $(wildcard rhec/workbench/templates/* rhec/workbench/templates/*/*)
	@$(PY) -m rhec.workbench.report $(EXECUTED)

# What each notebook used and made when it was last run.
$(RECORDS):
include $(wildcard $(RECORDS))

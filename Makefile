PYTHON ?= python3

# Notebooks of the paper's figures and tables, and of further studies, in the order of the report.
FIGURES := 00_start 03_scenario_a 04_scenario_b 05_computation_times
STUDIES := 01_tutorial 02_equations 06_claims multiverse 07_interpretations 08_beyond ensured \
  09_faults 10_replay 11_your_robot explore embedded

PY := .venv/bin/python
READY := .venv/ready
PIP := $(PY) -m pip --disable-pip-version-check install -q
executed = $(1:%=build/notebooks/%.ipynb)
EXECUTED := $(call executed,$(FIGURES) $(STUDIES))

# Only `make clean-NAME` removes these, `make clean` does not.
KEPT := campaigns replays explored embedded benchmarks
clean-campaigns := build/campaign
clean-replays := build/replay build/notebooks/10_replay-custom.*
clean-explored := figures/explored
clean-embedded := build/embedded
clean-benchmarks := figures/bench_*

# Two notebooks run at a time, each on half of the cores. Other goals run in their order.
ifeq ($(filter-out figures studies report,$(or $(MAKECMDGOALS),help)),)
MAKEFLAGS += -j2
export PYTHON_CPU_COUNT ?= $(shell echo $$((($$(getconf _NPROCESSORS_ONLN) + 1) / 2)))
endif

.PHONY: help figures studies claims report lab replay recordings replay-table calibrate campaign \
  embedded test test-browser lint bench soak storm lock upgrade clean $(KEPT:%=clean-%)

help: ## list the goals
	@sed -n 's/^##@ /\n/p; s/^\([a-z-]*\): .*## /  make \1\t/p' Makefile | expand -t 25

##@ The paper
# The longest notebook of each goal starts first.
figures: $(call executed,04_scenario_b $(FIGURES)) ## the paper's figures and tables, in figures/ (a minute)
studies: $(call executed,06_claims $(STUDIES)) ## further studies: claims, faults, replay … (minutes)
figures studies:
	@$(if $(filter $^,$(made)),$(PY) -m rhec.workbench.results)
	@echo '$@: $(if $(filter $^,$(made)),made,everything is up to date)'

claims: $(call executed,06_claims) ## only the claims ledger: figures/claims.csv, .tex, .md, .png

report: build/report/index.html ## all notebooks, documents and the reference as a site in build/report/
	@echo 'report: open build/report/index.html'

##@ Work
# Without news, updates and extensions from the network. Without a display it prints an address.
lab: $(READY) ## open the notebooks in JupyterLab
	@JUPYTER_CONFIG_PATH="$(CURDIR)/.jupyter:$$JUPYTER_CONFIG_PATH" $(PY) -m jupyter lab \
	  --ServerApp.preferred_dir=notebooks --LabApp.extension_manager=readonly \
	  --LabApp.news_url=None --LabApp.check_for_updates_class=jupyterlab.NeverCheckForUpdate \
	  $(if $(DISPLAY)$(WAYLAND_DISPLAY)$(filter Darwin,$(shell uname)),,--no-browser) \
	  $(if $(filter 0,$(shell id -u)),--allow-root)

# The environment passes the file name to the shell as data, not as part of a command.
replay calibrate: export REPLAY_LOG = $(value LOG)
log_given = test -n "$$REPLAY_LOG" || { echo 'LOG was not given; it must be a recorded log:' \
  'make $@ LOG=file.csv' >&2; exit 2; }
replay: $(READY) ## replay a recorded log into build/replay/: make replay LOG=file.csv
	@$(log_given)
	@$(PY) -m rhec.workbench.notebook notebooks/10_replay.ipynb -p log "$$REPLAY_LOG" $(WHAT)

recordings: $(READY) ## download the recordings of real robots in data/recordings.toml
	@$(PY) data/fetch_recordings.py $(HOST)

replay-table: $(READY) ## compute the table of docs/recorded_robots.md (after make recordings)
	@$(PY) -m rhec.workbench.studies.transfer

calibrate: $(READY) ## estimate noise and lever arm from a recorded log: make calibrate LOG=file.csv
	@$(log_given)
	@$(PY) -m rhec.logs.calibration "$$REPLAY_LOG"

campaign: $(READY) ## start or continue 1000 runs; WHAT="-p q [1,1,1] [1,1,0]" selects parameters
	@$(PY) -m rhec.simulation.campaigns $(WHAT)

embedded: $(READY) ## export the default scenario's estimator and controller as C to build/embedded
	@$(PY) -m notebooks.embedded_measurements

##@ Check
test: $(READY) ## run the tests
	@$(PY) -m pytest -n auto --ignore=tests/browser

test-browser: build/report/index.html ## test the pages in a headless Chromium
	@$(PY) -m pytest -rs tests/browser

lint: $(READY) ## check style, types of the public interface, imports, and notebooks for outputs
	@$(PY) -m ruff check --quiet
	@$(PY) -m ruff format --check
	@$(PY) -m mypy
	@.venv/bin/lint-imports --no-timing --no-cache > build/imports || { cat build/imports >&2; exit 1; }
	@git ls-files -z 'notebooks/*.ipynb' | xargs -0 $(PY) -m nbstripout --verify --keep-id

bench: .venv/peers .venv/acados ## compare computation times with other tools, in figures/ (minutes)
	@cd tests && ../$(PY) -m benchmark

soak: $(READY) ## simulate SAMPLES (ten million) samples with failing sensors (ten minutes)
	@$(PY) tests/soak.py --samples $(or $(SAMPLES),10000000)

storm: $(READY) ## a campaign of RUNS (100000) runs whose workers are killed repeatedly (20 minutes)
	@$(PY) tests/storm.py --runs $(or $(RUNS),100000)

##@ Maintain
lock: ## pin the packages of pyproject.toml in environment.txt, keeping old pins (needs uv)
upgrade: ## pin the newest versions that pyproject.toml allows (needs uv)
lock upgrade:
	@command -v uv >/dev/null || { echo 'make $@ needs uv on the PATH' >&2; exit 1; }
	@uv pip compile --quiet $(if $(filter upgrade,$@),--upgrade) --universal \
	  --python-version 3.11 --fork-strategy fewest --all-extras --group dev --generate-hashes \
	  --no-emit-index-url --no-emit-find-links --custom-compile-command 'make lock' \
	  --output-file environment.txt pyproject.toml

# MADE lists the files that notebooks and report have written; files in git stay.
clean: ## remove the executed notebooks, their figures and tables, and the report
	@rm -f $(filter-out $(shell sed -n 's/^!//p' .gitignore),$(MADE)) $(EXECUTED:.ipynb=.d) \
	  $(EXECUTED) $(wildcard build/notebooks/*.unfinished)
	@rm -rf build/report/live build/report/live.html
	@find build figures -type d -empty -delete 2>/dev/null || true

# Results that took long or that a user saved are removed only by name.
clean-campaigns: ## remove the rows of campaigns (build/campaign)
clean-replays: ## remove the results of replayed logs (build/replay)
clean-explored: ## remove figures saved in the explorer (figures/explored)
clean-embedded: ## remove the exported C (build/embedded)
clean-benchmarks: ## remove the tables and figures of make bench (figures/bench_*)
$(KEPT:%=clean-%):
	@rm -rf $($@)

$(READY): environment.txt pyproject.toml
	@$(PYTHON) -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' \
	  2>/dev/null || { echo "PYTHON was $(PYTHON) ($$($(PYTHON) --version 2>&1 | head -1));" \
	  "it must be Python 3.11 or newer with its venv module: make PYTHON=..." >&2; exit 1; }
	@echo "Setting up .venv with $$($(PYTHON) --version) (a minute or two the first time)"
	@$(PYTHON) -m venv .venv
	@$(PIP) --require-hashes -r environment.txt
	@$(PIP) --no-deps --no-build-isolation -e . && touch $@

.venv/peers: tests/benchmark/peers.txt $(READY)
	@$(PIP) --no-deps --require-hashes -r $< && touch $@

# acados has a separate environment, because its wheel contains another CasADi.
.venv/acados: tests/benchmark/acados.txt $(READY)
	@$(PY) -m venv $@ && $@/bin/python -m pip --disable-pip-version-check install -q --no-deps \
	  --require-hashes -r $< || { rm -rf $@; echo 'acados could not be installed' >&2; }

# The WebAssembly compiler for the live page, which the report leaves out without it.
.venv/wasm: rhec/workbench/live/zig.txt $(READY)
	@$(PIP) --no-deps --require-hashes -r $< || true
	@touch $@

# The reason for a run: `$?` are the files that are newer than the last run, or gone.
changed = $(wildcard $?)
gone = $(filter-out $(changed),$?)
is_gone = $(gone) $(if $(word 2,$(gone)),are,is) gone
why = $(strip $(if $(changed),$(changed) changed) $(if $(gone),$(if $(changed),and) $(is_gone)))

$(EXECUTED): build/notebooks/%.ipynb: notebooks/%.ipynb build/notebooks/%.d environment.txt \
  | $(READY)
	@echo '$*: $(if $(wildcard $@),made again because $(why),made for the first time)'
	@$(if $(filter $@,$(TIMED)),PYTHON_CPU_COUNT=default) $(PY) -m rhec.workbench.notebook $<
	$(eval made += $@)

# Notebooks that measure times run without others in parallel, after the paper's figures.
TIMED := $(call executed,05_computation_times embedded)
$(call executed,05_computation_times): | $(filter-out $(TIMED),$(call executed,$(FIGURES)))
$(call executed,embedded): | $(filter-out $(TIMED),$(call executed,$(STUDIES)))
ifneq ($(filter report test-browser figures,$(MAKECMDGOALS)),)
$(call executed,$(STUDIES)): | $(call executed,05_computation_times)
endif

build/report/index.html: $(EXECUTED) rhec/workbench/report.py README.md $(wildcard docs/*.md \
  docs/conf.py docs/_static/* docs/_templates/*/* rhec/workbench/live/*) | .venv/wasm
	@$(PY) -m rhec.workbench.results
	@$(PY) -m rhec.workbench.report $(EXECUTED) \
	  $$($(PY) -c 'import ziglang' 2>/dev/null && echo --live)
	@$(PY) -m rhec.workbench.live.page

# Inputs and outputs of each notebook in its last run.
$(EXECUTED:.ipynb=.d):
include $(wildcard $(EXECUTED:.ipynb=.d) build/report/report.d)

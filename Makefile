# What a user sets is data: make never expands it, and the shell gets it in quotes.
USER_SET := LOG WHAT SAMPLES RUNS HOST PYTHON PYTHON_CPU_COUNT
from_outside = $(filter environment command,$(firstword $(origin $1)))
$(foreach name,$(USER_SET),$(if $(call from_outside,$(name)),\
  $(eval override $(name) := $$(value $(name)))))
PYTHON ?= python3
SAMPLES ?= 10000000
RUNS ?= 100000
export LOG WHAT SAMPLES RUNS HOST PYTHON PYTHON_CPU_COUNT

# Notebooks of the paper's figures and tables, and of further studies, in the order of the report.
FIGURES := 00_start 03_scenario_a 04_scenario_b 05_computation_times
STUDIES := 01_tutorial 02_equations 06_claims 07_interpretations 08_beyond \
  09_faults 10_replay 11_your_robot 12_which_worlds 13_soil_map 14_gallery

PY := .venv/bin/python
READY := .venv/ready
# Python with the arguments in WHAT as well, quoted as in a shell but executed by none.
PY_WHAT := $(PY) -c 'import os, shlex, sys; sys.argv[0] = sys.executable; \
  os.execv(sys.executable, sys.argv + shlex.split(os.environ.get("WHAT", "")))'
PIP := $(PY) -m pip --disable-pip-version-check install -q
executed = $(1:%=build/notebooks/%.ipynb)
EXECUTED := $(call executed,$(FIGURES) $(STUDIES))

# Only `make clean-NAME` removes these, `make clean` does not.
KEPT := campaigns replays explored embedded benchmarks
clean-campaigns := build/campaign
clean-replays := build/replay build/notebooks/10_replay-custom.*
clean-explored := figures/explored
clean-embedded := build/embedded
benchmarks := agreement any_robot any_robot_agreement campaign campaign_kinds horizon start step \
  tails
clean-benchmarks := $(foreach suffix,csv tex png pdf,$(benchmarks:%=figures/bench_%.$(suffix)))

# Lines below add to these two. They start empty, whatever the environment holds.
MADE :=
made :=

# Two notebooks run at a time. Each may use all cores: one that waits, or works in a single process,
# leaves them to the other. Other goals run in their order.
ifeq ($(filter-out figures studies report,$(or $(MAKECMDGOALS),help)),)
MAKEFLAGS += -j2
endif

.PHONY: help figures studies check-figures claims report article lab replay recordings \
  replay-table calibrate campaign posterior embedded test test-browser lint bench soak fuzz storm \
  lock upgrade sbom clean \
  $(KEPT:%=clean-%)

help: ## list the goals
	@sed -n 's/^##@ /\n/p; s/^\([a-z-]*\): .*## /  make \1\t/p' Makefile | expand -t 25

##@ The paper
# The longest notebook of each goal starts first.
figures: $(call executed,04_scenario_b $(FIGURES)) ## the paper's figures and tables, in figures/ (a minute)
studies: $(call executed,06_claims $(STUDIES)) ## further studies: claims, faults, replay … (minutes)
figures studies:
	@$(if $(filter $^,$(made)),$(PY) -m rhec.workbench.results && $(PY) -m rhec.workbench.certificate)
	@echo '$@: $(if $(filter $^,$(made)),made,everything is up to date)'

check-figures: $(READY) ## compare your tables in figures/ with those that this commit made
	@$(PY) -m rhec.workbench.certificate --check

claims: $(call executed,06_claims) ## only the claims ledger: figures/claims.csv, .tex, .md, .png

report: build/report/index.html ## all notebooks, documents and the reference as a site in build/report/
	@echo 'report: open build/report/index.html'

article: $(READY) ## the article "[Re] …" as build/article.pdf, after make figures studies
	@$(PY) -m rhec.workbench.article

##@ Work
lab: $(READY) ## open the notebooks in JupyterLab
	@$(PY) -m rhec lab

log_given = test -n "$$LOG" || { echo 'LOG was not given; it must be a recorded log:' \
  'make $@ LOG=file.csv' >&2; exit 2; }
# Where `make replay` leaves what it made of this log.
log_folder = file=$${LOG%/}; file=$${file\#\#*/}; folder="build/replay/$${file%.*}"
replay: $(READY) ## replay a recorded log into build/replay/: make replay LOG=file.csv
	@$(log_given)
	@$(PY_WHAT) -m rhec.workbench.notebook notebooks/10_replay.ipynb -p log "$$LOG"

recordings: $(READY) ## fetch the recordings of real robots that data/recordings.toml names
	@$(PY) data/fetch_recordings.py $${HOST:+"$$HOST"}

replay-table: $(READY) ## compute the table of docs/recorded_robots.md (after make recordings)
	@$(PY) -m rhec.workbench.studies.transfer

calibrate: $(READY) ## estimate noise and lever arm from a recorded log: make calibrate LOG=file.csv
	@$(log_given)
	@$(log_folder); mkdir -p "$$folder"; \
	  $(PY_WHAT) -m rhec calibrate --yaml "$$folder/calibration.yaml" --overwrite "$$LOG"

campaign: $(READY) ## drive 1000 fields, or go on; WHAT="-p q [1,1,1] [1,1,0]" says which
	@$(PY_WHAT) -m rhec campaign

posterior: $(READY) ## find the worlds that give the paper's numbers, again (a quarter of an hour)
	@$(PY) -m rhec.workbench.studies.inverse

embedded: $(READY) ## the default scenario's estimator and controller as C, in build/embedded
	@$(PY) -m rhec.workbench.studies.embedded

##@ Check
# Tests of a file share what takes long to make, so one process runs them all, the longest first.
test: $(READY) ## run the tests; WHAT="--thorough" takes all of what is sampled otherwise
	@$(PY_WHAT) -m pytest -n auto --dist loadfile --no-loadscope-reorder --ignore=tests/browser

test-browser: build/report/index.html ## test the pages in a headless Chromium
	@$(PY) -m pytest -rs -n auto --dist loadfile -m 'not timed' tests/browser
	@$(PY) -m pytest -m timed tests/browser

lint: $(READY) ## check style, types of the public interface, imports, and notebooks for outputs
	@$(PY) -m ruff check --quiet
	@$(PY) -m ruff format --check
	@$(PY) -m mypy
	@report=$$(.venv/bin/lint-imports --no-cache) || { echo "$$report" >&2; exit 1; }
	@git ls-files -z 'notebooks/*.ipynb' | xargs -0 $(PY) -m nbstripout --verify --keep-id

bench: .venv/peers .venv/acados ## compare computation times with other tools, in figures/ (minutes)
	@cd tests && ../$(PY) -m benchmark

soak: $(READY) ## drive SAMPLES samples, ten million, with failing sensors (ten minutes)
	@$(PY) tests/soak.py --samples "$$SAMPLES"

fuzz: $(READY) ## absurd drives for the exported C under sanitizers; WHAT="--runs N" (minutes)
	@$(PY_WHAT) tests/fuzz

storm: $(READY) ## a campaign of RUNS runs, 100000, whose workers are killed all the time (20 minutes)
	@$(PY) tests/storm.py --runs "$$RUNS"

##@ Maintain
lock: ## pin the packages of pyproject.toml in environment.txt, keeping old pins (needs uv)
upgrade: ## pin the newest versions that pyproject.toml allows (needs uv)
lock upgrade:
	@command -v uv >/dev/null || { echo 'make $@ needs uv on the PATH' >&2; exit 1; }
	@uv pip compile --quiet $(if $(filter upgrade,$@),--upgrade) --universal \
	  --python-version 3.11 --fork-strategy fewest --all-extras --group dev --generate-hashes \
	  --no-emit-index-url --no-emit-find-links --custom-compile-command 'make lock' \
	  --output-file environment.txt pyproject.toml

sbom: $(READY) ## list all installed components and their licences: build/sbom.json (CycloneDX)
	@mkdir -p build
	@.venv/bin/cyclonedx-py environment $(PY) --output-format JSON -o build/sbom.json
	@echo 'sbom: build/sbom.json'

# MADE lists the files that notebooks and report have written; files in git stay.
clean: ## remove the executed notebooks, their figures and tables, and the report
	@rm -f $(filter-out $(shell sed -n 's/^!//p' .gitignore),$(MADE)) $(EXECUTED:.ipynb=.d) \
	  $(EXECUTED) $(wildcard build/notebooks/*.unfinished)
	@rm -rf build/report/live build/report/live.html figures/manifest.csv
	@find build figures -type d -empty -delete 2>/dev/null || true

# Results that took long or that a user saved are removed only by name.
clean-campaigns: ## remove the rows of campaigns (build/campaign)
clean-replays: ## remove the results of replayed logs (build/replay)
clean-explored: ## remove figures saved in the explorer (figures/explored)
clean-embedded: ## remove the exported C (build/embedded)
clean-benchmarks: ## remove the tables and pictures of make bench (figures/bench_…)
$(KEPT:%=clean-%):
	@rm -rf $($@)

$(READY): environment.txt pyproject.toml
	@"$$PYTHON" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' \
	  2>/dev/null || { echo "PYTHON was $$PYTHON ($$("$$PYTHON" --version 2>&1 | head -1));" \
	  "it must be Python 3.11 or newer with its venv module: make PYTHON=..." >&2; exit 1; }
	@echo "Setting up .venv with $$("$$PYTHON" --version) (a minute or two the first time)"
	@"$$PYTHON" -m venv .venv
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
	@$(PY) -m rhec.workbench.notebook $<
	$(eval made += $@)

# What measures time runs alone; made with studies, the paper's figures come before them.
TIMED := $(call executed,05_computation_times 11_your_robot)
$(call executed,05_computation_times): | $(filter-out $(TIMED),$(call executed,$(FIGURES)))
$(call executed,11_your_robot): | $(filter-out $(TIMED),$(call executed,$(STUDIES)))
ifneq ($(filter report test-browser figures,$(MAKECMDGOALS)),)
$(call executed,$(STUDIES)): | $(call executed,05_computation_times)
endif

build/report/index.html: $(EXECUTED) rhec/workbench/report.py README.md $(wildcard docs/*.md \
  docs/conf.py docs/_static/* docs/_templates/*/* rhec/workbench/live/* \
  rhec/workbench/live/freestanding/*) | .venv/wasm
	@$(PY) -m rhec.workbench.results
	@$(PY) -m rhec.workbench.report $(EXECUTED) --also $(wildcard $(clean-benchmarks)) \
	  $$($(PY) -c 'import ziglang' 2>/dev/null && echo --live)
	@$(PY) -m rhec.workbench.live.page

# Inputs and outputs of each notebook in its last run.
$(EXECUTED:.ipynb=.d):
include $(wildcard $(EXECUTED:.ipynb=.d) build/report/report.d)

# What a user sets is data: make never expands it, and the shell gets it in quotes.
USER_SET := ID id CLAIM PYTHON PYTHON_CPU_COUNT WHAT
from_outside = $(filter environment command,$(firstword $(origin $1)))
$(foreach name,$(USER_SET),$(if $(call from_outside,$(name)),\
  $(eval override $(name) := $$(value $(name)))))
PYTHON ?= python3
export $(USER_SET)

# Notebooks of the paper's figures and tables, and of further studies.
FIGURES := 00_start 03_scenario_a 04_scenario_b 05_computation_times
STUDIES := 01_tutorial 02_equations 06_claims 07_which_worlds 08_interpretations \
  $(sort $(patsubst notebooks/%.ipynb,%,$(wildcard notebooks/further/*.ipynb)))

PY := .venv/bin/python
READY := .venv/ready
# Python with the arguments in WHAT as well, quoted as in a shell but executed by none.
PY_WHAT := $(PY) -c 'import os, shlex, sys; sys.argv[0] = sys.executable; \
  os.execv(sys.executable, sys.argv + shlex.split(os.environ.get("WHAT", "")))'
PIP := $(PY) -m pip --disable-pip-version-check install
executed = $(1:%=build/notebooks/%.ipynb)
EXECUTED := $(call executed,$(FIGURES) $(STUDIES))

# Two notebooks run at a time. Each may use all cores: one that waits, or works in a single process,
# leaves them to the other. Other goals run in their order.
ifeq ($(filter-out figures studies report,$(or $(MAKECMDGOALS),help)),)
MAKEFLAGS += -j2
endif

.PHONY: help figures studies check-figures claim report article test smoke smoke-site \
  test-browser lint bench nightly lock clean

help: ## list the goals
	@sed -n 's/^##@ /\n/p; s/^\([a-z-]*\): .*## /  make \1\t/p' Makefile | expand -t 25

##@ The paper
# The notebooks that take longest start first. Scenario B takes some of its drives from A.
figures: $(call executed,03_scenario_a)
$(call executed,04_scenario_b): | $(call executed,03_scenario_a)
studies: $(call executed,06_claims further/traction_worth)
figures: $(call executed,$(FIGURES)) ## the paper's figures and tables, in figures/ (a minute)
studies: $(call executed,$(STUDIES)) ## further studies: claims, faults, recorded logs … (minutes)

check-figures: $(READY) ## compare your tables in figures/ with those that this commit made
	@$(PY) -m docs.site.check_figures

claim: $(READY) ## judge claims of the paper again, or list all: make claim ID=B6
	@$(PY) -m notebooks.claims "$${ID:-$${id:-$$CLAIM}}"

report: build/report/index.html ## all notebooks, documents and the reference as a site in build/report/
	@echo 'report: open build/report/index.html'

article: $(READY) ## the article "[Re] …" as build/article.pdf, after make figures studies
	@$(PY) -m docs.article.article

##@ Check
# Tests of a file share what takes long to make, so one process runs them all, the longest first.
test: $(READY) ## run the tests; WHAT="tests/core -k rhe" runs some of them
	@$(PY_WHAT) -m pytest -n auto --dist loadfile --no-loadscope-reorder --ignore=tests/browser \
	  --ignore=tests/smoke

smoke: $(READY) ## run every notebook with small parameters, and look at its tables
	@$(PY) -m pytest -n auto tests/smoke

test-browser: build/report/index.html ## test the pages in a headless Chromium
	@$(PY) -m pytest --thorough -rs -n auto --dist loadfile tests/browser

lint: $(READY) ## check style, types of the public interface, imports, and notebooks for outputs
	@$(PY) -m ruff check --quiet
	@$(PY) -m ruff format --check
	@$(PY) -m mypy
	@report=$$(.venv/bin/lint-imports --no-cache) || { echo "$$report" >&2; exit 1; }
	@git ls-files -z 'notebooks/*.ipynb' | xargs -0 $(PY) -m nbstripout --verify --keep-id \
	  --extra-keys metadata.language_info

bench: .venv/peers .venv/acados ## compare times with other tools, in docs/performance.md (minutes)
	@$(PY_WHAT) -m benchmark
	@$(PY) -m docs.site.results

nightly: $(READY) .venv/engines ## what takes long: every test, failing sensors, killed workers, fuzzing, studies
	@$(MAKE) test WHAT=--thorough
	@$(MAKE) figures studies
	@$(PY) data/fetch_recordings.py && $(PY) -m notebooks.further.recorded.page && \
	  $(PY) -m notebooks.further.transfer
	@$(PY) -m notebooks.further.recorded.verdicts
	@$(MAKE) check-figures
	@$(MAKE) test-browser
	@$(PY) tests/soak.py
	@$(PY) tests/storm.py
	@$(PY) tests/fuzz

##@ Maintain
lock: ## pin what pyproject.toml names in environment.txt; UPGRADE=1 renews all pins (needs uv)
	@command -v uv >/dev/null || { echo 'make lock needs uv on the PATH' >&2; exit 1; }
	@uv pip compile --quiet $(if $(UPGRADE),--upgrade) --universal \
	  --python-version 3.11 --fork-strategy fewest --all-extras --group dev --generate-hashes \
	  --no-emit-index-url --no-emit-find-links --custom-compile-command 'make lock' \
	  --output-file environment.txt pyproject.toml

# Results that took long stay: build/campaign and figures/explored.
clean: ## remove the executed notebooks, their figures and tables, and the report
	@test ! -e build/made || grep -vxF "$$(git ls-files figures 2>/dev/null)" build/made | tr '\n' '\0' | xargs -0 rm -f
	@rm -rf build/made build/notebooks build/report

$(READY): environment.txt pyproject.toml
	@test ! -L .venv || { echo '.venv is a link to the environment of another checkout, which is' \
	  'not changed from here; remove the link, and make sets up an environment' >&2; exit 1; }
	@"$$PYTHON" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' \
	  2>/dev/null || { echo "PYTHON was $$PYTHON ($$("$$PYTHON" --version 2>&1 | head -1));" \
	  "it must be Python 3.11 or newer with its venv module: make PYTHON=..." >&2; exit 1; }
	@echo "Setting up .venv with $$("$$PYTHON" --version) (a minute or two the first time)"
	@"$$PYTHON" -m venv .venv
	@echo "Installing $$(grep -c == environment.txt) packages"
	@# Every ten seconds, for as long as this shell lives, a line says what pip is at.
	@(s=0; while sleep 10 && kill -0 $$$$ 2>/dev/null; do s=$$((s + 10)); \
	  echo "  $$s s: $$(grep -v WARNING .venv/pip.log | tail -n 1 | cut -c 1-80)"; done) & \
	  $(PIP) --require-hashes -r environment.txt > .venv/pip.log 2>&1 || \
  { tail .venv/pip.log >&2; exit 1; }
	@$(PIP) -q --no-deps --no-build-isolation -e . && touch $@

.venv/peers: benchmark/peers.txt $(READY)
	@$(PIP) -q --no-deps --require-hashes -r $< && touch $@ || echo 'do-mpc could not be installed' >&2

# Dask, MPI and ipyparallel, on which campaigns are tested.
.venv/engines: tests/engines.txt $(READY)
	@$(PIP) -q --no-deps --require-hashes -r $< && touch $@

# acados has a separate environment, because its wheel contains another CasADi.
.venv/acados: benchmark/acados.txt $(READY)
	@$(PY) -m venv $@ && $@/bin/python -m pip --disable-pip-version-check install -q --no-deps \
	  --require-hashes -r $< || { rm -rf $@; echo 'acados could not be installed' >&2; }

# The WebAssembly compiler for the live page, which the report leaves out without it.
.venv/wasm: docs/live/zig.txt $(READY)
	@$(PIP) -q --no-deps --require-hashes -r $< || true
	@touch $@

# A notebook runs again after an edit of its cells, of the package, or of a module beside it.
PACKAGE := environment.txt $(wildcard data/*.csv data/*.npz data/*.parquet) \
  $(shell find rhec notebooks -name '*.py' -o -name '*.csv' -o -name '*.toml' -o -name '*.[ch]' | sort)
$(EXECUTED): build/notebooks/%.ipynb: notebooks/%.ipynb $(PACKAGE) | $(READY)
	@$(PY) -m notebooks.run $< $(if $(filter-out $<,$?),,--if-edited)

# What measures time runs alone; made with studies, the paper's figures come before them.
TIMED := $(call executed,05_computation_times)
$(TIMED): | $(filter-out $(TIMED),$(call executed,$(FIGURES)))
ifneq ($(filter report test-browser figures,$(MAKECMDGOALS)),)
$(call executed,$(STUDIES)): | $(TIMED)
endif

# The site of the notebooks with small parameters, which `make smoke` left.
smoke-site: .venv/wasm
	@RHEC_FIGURES=build/smoke/figures $(PY) -m docs.site.report build/smoke/*.ipynb \
	  build/smoke/further/*.ipynb

build/report/index.html: $(EXECUTED) README.md $(shell find docs -type f) | .venv/wasm
	@$(PY) -m docs.site.report $(EXECUTED)

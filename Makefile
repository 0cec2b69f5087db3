# make demo   - install what is needed, then see through simulated glass; pictures land in demo/
# make test   - install what is needed, then lint, types, layers and all fast tests
# make slow SHARD=3/16 - 10 to 20 min of the slow tests; the last line of `make test` says what they said last
SHELL := /bin/bash
PY ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
SITE_STAMP := $(VENV)/.installed-docs

# Tests start hundreds of processes: what Python compiles of modules is kept.
unexport PYTHONDONTWRITEBYTECODE
# As the command sets it (rtpiv/command_line/cli.py): small matrices shared by the cores of busy tests take several times as long.
export OPENBLAS_NUM_THREADS = 1

.PHONY: demo test test-slow test-without-posix slow slow-balance docs docs-check coverage dist labs lab-table fuzz lamps sheets starts benchmark bench lint style types prepared-tests fast-tests digests mutants compiled-rays compiled-frames collected picture pins clean

$(STAMP): requirements.txt pyproject.toml
	@if command -v uv >/dev/null; then \
	  [ -x $(BIN)/python ] || uv venv -q --python $(PY) $(VENV); \
	  uv pip install -q --python $(BIN)/python -r requirements.txt && uv pip install -q --python $(BIN)/python --no-deps -e .; \
	else \
	  [ -x $(BIN)/python ] || $(PY) -m venv $(VENV); \
	  $(BIN)/python -m pip install -q --disable-pip-version-check --no-compile -r requirements.txt && \
	  $(BIN)/python -m pip install -q --disable-pip-version-check --no-deps -e .; \
	fi
	@touch $@

demo: $(STAMP)
	$(BIN)/rtpiv demo -o demo

test: $(STAMP)
	@$(MAKE) --no-print-directory -j5 style prepared-tests types
	@$(BIN)/python -m tests.slow_suite

prepared-tests: compiled-rays compiled-frames collected
	@$(MAKE) --no-print-directory fast-tests

fast-tests: $(STAMP)
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

# As on a system without POSIX: what Windows lacks is hidden from the packages
test-without-posix: $(STAMP)
	$(BIN)/python -m pytest -p tests.no_posix.plugin -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

test-slow: $(STAMP)
	$(BIN)/python -m pytest -m slow

# One of sixteen parts of the slow tests; what it says is kept in tests/slow_suite.json, with the commit
SHARD ?= 1/16
slow: $(STAMP)
	$(BIN)/python -m tests.slow_suite $(SHARD)

slow-balance: $(STAMP)
	$(BIN)/python -m tests.slow_suite balance

# The site in docs/_build/html, from pages, docstrings, parser and schemas; every warning and every lost link is an error
docs: $(SITE_STAMP)
	rm -rf docs/_build/html
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html
	$(BIN)/python docs/made/links.py docs/_build/html

$(SITE_STAMP): docs/requirements.txt $(STAMP)
	@if command -v uv >/dev/null; then uv pip install -q --python $(BIN)/python -r $<; \
	else $(BIN)/python -m pip install -q --disable-pip-version-check --no-compile -r $<; fi
	@touch $@

# Commands, names and links of README and docs
docs-check: $(STAMP)
	$(BIN)/python -m pytest -n0 tests/system/test_pages.py tests/system/test_site.py tests/system/test_tutorials.py \
	  tests/rtpiv/test_page.py tests/faces/test_python_page.py

# Lines that the fast tests reach, kernels by a run of their tests that compiles nothing: htmlcov/index.html
INTERPRETED = tests/tracer/test_kernels.py tests/piv/correlation/test_refine.py tests/piv/resampling/test_sample.py \
  tests/daq/cameras/test_pixels.py
coverage: $(STAMP)
	$(BIN)/python -m coverage erase
	-$(BIN)/python -m coverage run -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder
	-NUMBA_DISABLE_JIT=1 $(BIN)/python -m coverage run -m pytest -n0 -W ignore::RuntimeWarning $(INTERPRETED)
	$(BIN)/python -m coverage combine -q
	$(BIN)/python -m coverage html -q
	$(BIN)/python -m coverage report --skip-covered --sort=cover

# In dist/ the sdist, a plain wheel, and on Linux one with machine code for this Python, some minutes of compiling;
# a version is written into every file that says it: make dist VERSION=0.2.0
VERSION ?=
dist: $(STAMP)
ifneq ($(VERSION),)
	@[[ "$(VERSION)" =~ ^[0-9]+(\.[0-9]+)+((a|b|rc)[0-9]+)?$$ ]] || { echo "VERSION=$(VERSION) is no version; say it as 0.2.0 or 0.2.0rc1."; exit 1; }
	sed -i.bak -E 's/^version( = "|: )[^"]*("?)$$/version\1$(VERSION)\2/' pyproject.toml {piv,stages,tracer}/pyproject.toml CITATION.cff
	rm -f *.bak {piv,stages,tracer}/*.bak
endif
	rm -rf dist build/machine_code
	$(BIN)/python -m hatchling build -t sdist -t wheel -d dist
	@[ "$$(uname -sm)" = "Linux x86_64" ] || { echo "Machine code is made on Linux x86-64 alone: the wheel is plain."; exit 0; }; \
	$(BIN)/python -m release.machine_code build/machine_code && $(BIN)/python -m hatchling build -t wheel -d dist

# Hundreds of drawn labs, right and wrong ones: is the wrong model named, is one sigma one sigma?
LABS ?= 100
labs: $(STAMP)
	LABS=$(LABS) $(BIN)/python -m pytest -q -s -m slow tests/correction/fit/test_strangers.py

# The same as a table, one row a lab, and labs that are photographed: make lab-table KIND=rendered LABS=300 WORKERS=8;
# KIND=faults are labs with one fault each of thirty kinds
KIND ?= benches
WORKERS ?= 2
lab-table: $(STAMP)
	$(BIN)/python -m tests.correction.fit.lab_table $(KIND) --labs $(LABS) --workers $(WORKERS) -o labs_$(KIND).csv

# Random sequences of commands, faults, stops and restarts before the judge, and random damage to every file that is
# read: make fuzz SEQUENCES=100000 CASES=100000 SEED=1
SEQUENCES ?= 10000
CASES ?= 10000
SEED ?= 1
fuzz: $(STAMP)
	FUZZ_SEQUENCES=$(SEQUENCES) FUZZ_CASES=$(CASES) FUZZ_SEED=$(SEED) $(BIN)/python -m pytest -m slow --timeout 0 -n 2 tests/fuzz/benches/test_stages.py \
	tests/fuzz/benches/test_laser.py tests/fuzz/benches/test_light.py tests/fuzz/files/test_commands.py tests/fuzz/files/test_damaged_files.py

# Target frames in the light of twelve lamps: is the map right where the lamp is told, inside its sigma where not?
lamps: $(STAMP)
	$(BIN)/python -m pytest -m slow -n0 -s -rA tests/correction/fit/test_lamps.py

# Light sheets off the target's plane, found in simulated flows: how far off, and what it costs
sheets: $(STAMP)
	$(BIN)/python -m pytest -m slow -n0 -s -rA tests/correction/light_sheet/test_drawn_sheets.py

# Fits begun beside the truth, by up to 5 mm: found, refused, or masked by name? make starts STARTS=100
STARTS ?= 40
starts: $(STAMP)
	STARTS=$(STARTS) $(BIN)/python -m pytest -m slow -n0 -s -rA tests/correction/fit/test_convergence.py

# What users compute, as SHA-256, to compare on one computer: make digests, or make digests AGAINST=digests.json
AGAINST ?=
digests: $(STAMP)
	$(BIN)/python -m tests.digests $(if $(AGAINST),--against $(AGAINST),-o digests.json)

# Faults of one line each in a copy of the checkout: does a test fail for every one? make mutants ONLY=keep_out
ONLY ?=
mutants: $(STAMP)
	$(BIN)/python -m tests.mutants $(ONLY)

bench: benchmark

benchmark: $(STAMP)
	$(BIN)/python -m benchmarks.commands -o benchmarks/results
	$(BIN)/python -m benchmarks.race --rays 300
	$(BIN)/python -m benchmarks.wanted

# What most tests need is compiled first, in two processes that share next to nothing: tests would compile it twice.
compiled-rays: $(STAMP)
	@$(BIN)/python -c "from tests.system.test_cold_start import compile_rays; compile_rays()"

compiled-frames: $(STAMP)
	@$(BIN)/python -c "from tests.system.test_cold_start import compile_frames; compile_frames()"

# Each process of the tests reads all their files; what that leaves on the disk is left there once, in a new checkout.
# Errors are theirs to say.
collected: $(STAMP)
	-@[ -d tests/__pycache__ ] || $(BIN)/python -m pytest -n0 -q --collect-only >/dev/null

lint: style types

style: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

# A minute without its cache, beside compilation and tests, which come first where cores are few.
types: $(STAMP)
	nice $(BIN)/mypy

# The pictures in the README: a bed of 22 balls on its simulated bench, and the demo's report in a headless browser
# (needs chromium).
BENCH_RUN = --simulate --home --operator me
picture: demo
	rm -rf demo/bed
	$(BIN)/rtpiv init demo/bed --arrangement bcc --layers 3 --plane 1 --sensor-px 960 768 --pixel-pitch-um 4.8 \
	  --lens-mm 25 --yes
	cd demo/bed && $(CURDIR)/$(BIN)/rtpiv acquire plan-target.yaml --bench bench.yaml $(BENCH_RUN) --no-correct \
	  && $(CURDIR)/$(BIN)/rtpiv calibrate runs/*plan-target -o bedfit \
	  && $(CURDIR)/$(BIN)/rtpiv acquire plan-flow.yaml --bench bench-flow.yaml $(BENCH_RUN) \
	  && $(CURDIR)/$(BIN)/rtpiv mean runs/*plan-flow --scene bedfit/scene.yaml --final-window 16 \
	  && $(CURDIR)/$(BIN)/rtpiv trace bedfit/scene.yaml --out light
	cp demo/bed/light/light.png docs/images/bed-light.png
	cp demo/bed/runs/*plan-flow/series/mean.png docs/images/bed-mean.png
	chromium --headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking \
	  --hide-scrollbars --window-size=900,1130 --user-data-dir=demo/browser \
	  --screenshot=docs/images/report.png "file://$(CURDIR)/demo/report/report.html"
	cp demo/fitted/overview.png docs/images/overview.png
	rm -rf demo/browser

# Resolve the pinned versions anew (needs uv); the file records versions only. What clusters need is not among them:
# twenty packages for tests that are skipped without them.
pins:
	uv pip compile -q --universal --python-version 3.11 --no-annotate --no-header --no-emit-index-url \
	  --extra camera --extra hdf5 --extra live --extra mesh --extra micromanager --extra video --group test --group lint pyproject.toml -o requirements.txt
	uv pip compile -q --universal --python-version 3.11 --no-annotate --no-header --no-emit-index-url \
	  --group docs --constraint requirements.txt -o docs/requirements.txt

clean:
	rm -rf $(VENV) demo dist htmlcov docs/_build .pytest_cache .mypy_cache .ruff_cache

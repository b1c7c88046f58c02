# What a person types. Each target makes the environment it needs first; `make` alone lists them.
PYTHON ?= python3
VENV ?= .venv
BENCH_VENV ?= .venv-bench
BIN := $(VENV)/bin
# One worker a core, each single-threaded: more threads than cores only get in each other's way. Bytecode is kept, even
# where the environment says otherwise: the hundreds of processes that the tests start would compile every module again.
PYTEST := PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest \
	-n logical --maxprocesses 8 --dist worksteal -p no:cacheprovider

.PHONY: help environment demo prove test test-slow test-all test-times test-long check fuzz language docs lock package sbom bench system clean

help:
	@echo "make demo       calibrate a recording and write a report page"
	@echo "make test       the fast tests"
	@echo "make test-slow  the slow tests"
	@echo "make test-all   both, in one run"
	@echo "make test-times both, and a list of the tests above 0.7 s, which are then slow ones"
	@echo "make test-long  the statistical studies on hundreds of recordings (hours)"
	@echo "make check      lint, format, import rules, house style"
	@echo "make fuzz       20,000 damaged inputs to every reader and command (an hour)"
	@echo "make language   words that the project no longer uses"
	@echo "make docs       the documentation site, in site/"
	@echo "make prove      the blind benchmark: cases of every suite, and a scoreboard (hours)"
	@echo "make package    build sdist and wheel, and run the wheel outside the checkout"
	@echo "make lock       resolve requirements.lock again (needs uv)"
	@echo "make sbom       bill of materials (CycloneDX) and licences, in dist/"
	@echo "make bench      speed against other libraries, in an environment of its own"

# What tests, checks and documentation need. Two installations into one environment must not run at once, so that a
# call with --jobs comes after it.
environment: $(VENV)/.test
	@$(MAKE) --no-print-directory $(VENV)/.docs

demo: $(VENV)/.demo
	$(BIN)/workbench demo

prove: $(VENV)/.test
	$(BIN)/workbench prove

test: $(VENV)/.test
	$(PYTEST) -m "not slow and not long"

test-slow: $(VENV)/.test
	$(PYTEST) -m "slow and not long"

test-all: $(VENV)/.test
	$(PYTEST) -m "not long" --durations=30 --durations-min=5

test-times: $(VENV)/.test
	$(PYTEST) -m "not long" --junitxml=build/tests.xml
	$(BIN)/python tools/slow_tests.py build/tests.xml

test-long: $(VENV)/.test
	$(PYTEST) -m long

check: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache
	$(BIN)/python tools/check_style.py
	$(BIN)/python tools/check_names.py
	$(BIN)/python tools/check_language.py
	$(BIN)/python tools/effects_page.py --check
	$(BIN)/python tools/api_stub.py --check
	$(BIN)/python tools/api_summary.py --check

fuzz: $(VENV)/.test
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python tools/fuzz.py --inputs 20000 --minutes 600

language: $(VENV)/.test
	$(BIN)/python tools/check_language.py

docs: $(VENV)/.docs
	$(BIN)/python tools/commands_page.py
	$(BIN)/python tools/schema_page.py
	$(BIN)/mkdocs build --strict --quiet
	@echo site/index.html

# The lock is resolved from the package index; FIND_LINKS names a folder or page with PyTorch for processors.
FIND_LINKS ?= https://download.pytorch.org/whl/cpu/torch/
lock:
	head -3 requirements.lock > requirements.new
	head -2 requirements-torch.lock > requirements-torch.new
	uv pip compile pyproject.toml --python-platform x86_64-manylinux_2_35 --python-version 3.11 \
		--generate-hashes --no-header --no-annotate --quiet --find-links $(FIND_LINKS) > requirements.all
	awk '/^[a-z]/ { torch = /^torch==/ } torch' requirements.all >> requirements-torch.new
	awk '/^[a-z]/ { torch = /^torch==/ } !torch' requirements.all >> requirements.new
	mv requirements.new requirements.lock && mv requirements-torch.new requirements-torch.lock
	rm requirements.all

package: $(VENV)/.test
	$(BIN)/python tools/check_package.py

sbom: $(VENV)/.demo
	$(BIN)/python tools/sbom.py dist

bench: $(BENCH_VENV)/.bench
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BENCH_VENV)/bin/python -m benchmarks

system:
	@tools/system-libraries

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "$(PYTHON) is older than 3.11: name a newer one, as in make PYTHON=python3.12" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.demo: pyproject.toml requirements.lock requirements-torch.lock | $(VENV)/bin/python system
	@if $(BIN)/python tools/lock_applies.py; then \
		$(BIN)/python -m pip install --quiet --no-deps --require-hashes -r requirements-torch.lock && \
		$(BIN)/python -m pip install --quiet --no-deps --require-hashes -r requirements.lock && \
		$(BIN)/python -m pip install --quiet --no-deps --editable .; \
	else \
		$(BIN)/python -m pip install --quiet --editable .; \
	fi
	@touch $@

$(VENV)/.test: pyproject.toml | $(VENV)/bin/python system
	$(BIN)/python -m pip install --quiet --editable ".[test]"
	@touch $@ $(VENV)/.demo

$(VENV)/.docs: pyproject.toml | $(VENV)/bin/python system
	$(BIN)/python -m pip install --quiet --editable ".[docs]"
	@touch $@

# pybotics pins numpy<2, yet runs with numpy 2: it is installed without its pins.
$(BENCH_VENV)/.bench: pyproject.toml
	$(PYTHON) -m venv $(BENCH_VENV)
	$(BENCH_VENV)/bin/python -m pip install --quiet --editable ".[bench]"
	$(BENCH_VENV)/bin/python -m pip install --quiet --no-deps pybotics==3.1.2
	@touch $@

clean:
	rm -rf build dist site *.egg-info .pytest_cache .ruff_cache .import_linter_cache .hypothesis

# SPDX-License-Identifier: GPL-3.0-or-later
# make render   set up .venv, render the gallery to out/gallery.png and print its path
# make test     set up .venv, run the fast tests in JOBS=2 processes (make slow: the long ones, one by one)
# make package  build and validate the extension's zips in dist/
# make gui      drive a real Blender window with the installed extension; pictures in out/gui/
# make figures  draw the paper's figures to out/figures and write docs/figures.md (SCENES="A.blend B.blend")
# make docs     renew the table of docs/settings.md; make plots: draw docs/plots/*.svg from the tables of docs/*.md
# make lint     ruff; make lock: requirements.txt anew; make clean
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help setup render test slow gui figures lint docs plots lock package clean

PYTHON = .venv/bin/python
PYTEST = $(PYTHON) -m pytest
SCENE ?= sample_blends/gallery.blend
OUTPUT ?= $(CURDIR)/out/gallery.png
RENDER_ARGUMENTS ?= --size 640 360 --samples 32 --integrator reference
TESTS ?=
JOBS ?= 2
SCENES ?=
FIGURE_ARGUMENTS ?=
VERSION := $(shell sed -n 's/^version = "\(.*\)"/\1/p' blender_manifest.toml)
WHEEL_LINUX := $(shell sed -n 's,.*"\./\(wheels/.*manylinux.*\.whl\)".*,\1,p' blender_manifest.toml)
WHEEL_WINDOWS := $(shell sed -n 's,.*"\./\(wheels/.*win_amd64\.whl\)".*,\1,p' blender_manifest.toml)
ZIPS := dist/burnish-$(VERSION)-linux_x64.zip dist/burnish-$(VERSION)-windows_x64.zip
SOURCES := $(shell find addon engine kernels ui -name '*.py' -o -name 'hosek.txt' 2>/dev/null) __init__.py blender_manifest.toml LICENSE

help:
	@sed -n 's/^# make/make/p' Makefile

# Blender's module exists for Python 3.13 (5.2) and 3.11 (5.0) only. The mark .venv/.ready names what was installed
# and where, so that a changed requirement, a moved checkout or a broken interpreter is noticed.
setup:
	@mark="$$(cat requirements.txt pyproject.toml | cksum) $(CURDIR)"; \
	if command -v flock >/dev/null; then exec 9>.venv.lock; flock 9; fi; \
	if [ "$$(cat .venv/.ready 2>/dev/null)" = "$$mark" ] && $(PYTHON) -c '' 2>/dev/null; then exit 0; fi; \
	found=; for python in python3.13 ~/.pyenv/versions/3.13.*/bin/python3.13 \
	                      python3.11 ~/.pyenv/versions/3.11.*/bin/python3.11; do \
	  if "$$python" -c 'import venv, ensurepip' >/dev/null 2>&1; then found=$$python; break; fi; done; \
	if [ -z "$$found" ]; then echo "Python 3.13 or 3.11 with venv is needed; install one and run make again." >&2; exit 1; fi; \
	echo "Setting up .venv with $$found (downloads about 700 MB the first time) ..." >&2; \
	"$$found" -m venv --clear .venv; \
	$(PYTHON) -m pip install --quiet --disable-pip-version-check --retries 5 --require-hashes -r requirements.txt; \
	$(PYTHON) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --no-index -e .; \
	rm -rf build; echo "$$mark" >.venv/.ready

render: setup
	@.venv/bin/burnish render "$(SCENE)" --output "$(OUTPUT)" $(RENDER_ARGUMENTS)

# A process that crashes ends the run: what it still had to do would otherwise be waited for without end.
test: setup
	@.venv/bin/burnish warmup --device cpu
	@$(PYTEST) -q -m "not slow and not window" -n $(JOBS) --dist loadfile --max-worker-restart 0 $(TESTS)

slow: setup
	@$(PYTEST) -q -m "slow and not window" $(TESTS)

gui: $(firstword $(ZIPS))
	@$(PYTEST) -q -s -m window tests/gui

figures: setup
	@$(PYTHON) tests/performance/figures.py $(FIGURE_ARGUMENTS) $(SCENES)

lint: setup
	@$(PYTHON) -m ruff check .

docs: setup
	@$(PYTHON) tests/readme_settings.py --write

plots: setup
	@$(PYTHON) tests/performance/plots.py

lock: setup
	@$(PYTHON) -m venv --clear out/uv && out/uv/bin/pip install --quiet uv
	@out/uv/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header \
	  --no-emit-index-url --no-annotate --all-extras pyproject.toml --output-file requirements.txt

# Wheels are checked against the hashes in requirements.txt.
wheels/requirements.txt: requirements.txt
	@mkdir -p wheels
	@awk '/^[^ ]/ {keep = /^warp-lang==/} keep' requirements.txt | sed '$$ s/ *\\$$//' >$@

$(WHEEL_LINUX): wheels/requirements.txt | setup
	@$(PYTHON) -m pip download --quiet --disable-pip-version-check --require-hashes --no-deps --only-binary=:all: \
	  --platform manylinux_2_28_x86_64 --dest wheels --requirement $< && touch $@

$(WHEEL_WINDOWS): wheels/requirements.txt | setup
	@$(PYTHON) -m pip download --quiet --disable-pip-version-check --require-hashes --no-deps --only-binary=:all: \
	  --platform win_amd64 --dest wheels --requirement $< && touch $@

package: $(firstword $(ZIPS))
	@ls -s -h $(ZIPS)

$(firstword $(ZIPS)): $(SOURCES) $(WHEEL_LINUX) $(WHEEL_WINDOWS) | setup
	@rm -rf dist && mkdir -p dist
	@tool=$$(ls .venv/lib/python*/site-packages/bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py); \
	$(PYTHON) "$$tool" build --source-dir . --output-dir dist --split-platforms >dist/build.log || { cat dist/build.log >&2; exit 1; }; \
	for zip in $(ZIPS); do $(PYTHON) "$$tool" validate "$$zip" >>dist/build.log || { cat dist/build.log >&2; exit 1; }; done

clean:
	@rm -rf .venv .venv.lock build dist out wheels *.egg-info .hypothesis .pytest_cache .ruff_cache
	@find . -name __pycache__ -prune -exec rm -rf {} +

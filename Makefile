# Everything runs in .venv, which is made on first use. Second runs reinstall only when pyproject.toml or constraints.txt
# changed. Only Python 3.11 or later, with pip and venv, has to be there: make fit PYTHON=python3.12
PYTHON ?= python3
VENV ?= .venv
PYTEST_ARGS ?=
MUTANTS_ARGS ?=

BIN := $(VENV)/bin
# In CI errors only, so that its log stays short. A person sees each package and its download: the first time takes minutes.
PIP_FLAGS := $(if $(CI),-qq) --disable-pip-version-check
INSTALL := $(BIN)/python -m pip install $(PIP_FLAGS) --constraint constraints.txt
EXAMPLE := warp_partdr/assets/example
SOURCES := $(shell find warp_partdr kernels body demos/viewer -type f -not -path '*/__pycache__/*')

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help fit demo test mutants install dev lint format types layout docs dist pictures wheel-check clean

help:  ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /  make \1|/p' $(MAKEFILE_LIST) | column -t -s '|'

fit: out/example/people.json  ## fit a body to the packaged photo, from nothing else; the result is in out/example
	@echo "The fitted body is in $(<D): open report.html first, then person0 and scene.glb in Blender; people.json has the numbers."

out/example/people.json: $(VENV)/.installed $(SOURCES)
	$(BIN)/partdr fit $(EXAMPLE)/photo.png --out $(@D)

demo: $(VENV)/.installed-demo  ## open the interactive demo, in a browser where there is no display
	$(BIN)/partdr demo $(if $(DISPLAY)$(WAYLAND_DISPLAY),,$(if $(filter Linux,$(shell uname)),--web)) --out out/demo

test: $(VENV)/.installed-dev  ## run the tests, in two processes; PYTEST_ARGS="-k name" chooses
	$(BIN)/python -m pytest -n 2 --dist worksteal $(PYTEST_ARGS)

mutants: $(VENV)/.installed-dev  ## break the code a place at a time: do the tests notice? MUTANTS_ARGS=--quick tries a few, "--since main" what changed
	$(BIN)/python scripts/mutants.py $(MUTANTS_ARGS)

install: $(VENV)/.installed  ## make .venv and install the package into it, editable
dev: $(VENV)/.installed-dev  ## the same with what tests, linter and type checker need

lint: $(VENV)/.installed-dev  ## ruff: rules and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(VENV)/.installed-dev  ## let ruff put right what it can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# mypy and mkdocs do not follow setuptools' editable finder, so they are shown the package's real layout, of links.
types: $(VENV)/.installed-dev layout  ## mypy
	$(BIN)/mypy build/typing/warp_partdr

layout:
	@rm -rf build/typing && mkdir -p build/typing/warp_partdr
	@ln -s $(foreach entry,$(wildcard warp_partdr/*) kernels body demos/viewer,../../../$(entry)) build/typing/warp_partdr/

docs: $(VENV)/.installed-docs layout  ## build the documentation site in build/site; open index.html there
	$(BIN)/python scripts/make_site.py build/pages
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

# Twice, so that what differs from one build to the next is seen. The sdist is packed anew: setuptools writes times and owners into it.
dist: export SOURCE_DATE_EPOCH = $(shell git log -1 --format=%ct)
dist: $(VENV)/.installed-release  ## build sdist and wheel in build/dist as a package index wants them
	rm -rf build/dist build/again build/lib build/bdist.* && mkdir -p build
	for folder in dist again; do $(BIN)/python -m build --no-isolation --outdir build/$$folder . >build/$$folder.log 2>&1 || \
		{ cat build/$$folder.log; exit 1; }; \
		sdist=$$(echo build/$$folder/*.tar.gz); tar -xzf $$sdist -C build/$$folder; name=$$(basename $$sdist .tar.gz); \
		tar -C build/$$folder --sort=name --format=ustar --mtime=@$$SOURCE_DATE_EPOCH --owner=0 --group=0 --numeric-owner \
			--mode=u=rwX,go=rX -c $$name | gzip -n9 >build/$$name.tar.gz && mv build/$$name.tar.gz $$sdist; rm -r build/$$folder/$$name; \
	done
	cmp build/dist/*.whl build/again/*.whl
	cmp build/dist/*.tar.gz build/again/*.tar.gz
	$(BIN)/twine check --strict build/dist/*.whl build/dist/*.tar.gz

pictures: $(VENV)/.installed  ## draw the pictures of README and docs anew
	$(BIN)/python scripts/pictures.py

# A user's view: the wheel alone, in an environment of its own, from another folder. A library that logs a traceback there
# and goes on (a package that only the tests install) fails it too.
wheel-check: $(VENV)/.installed-dev  ## build the wheel, install it cleanly, run `partdr --help` and a fit with it
	rm -rf build/lib build/bdist.* build/wheel build/elsewhere
	$(BIN)/python -m pip wheel $(PIP_FLAGS) --no-deps --no-build-isolation --wheel-dir build/wheel .
	$(PYTHON) -m venv --clear build/wheel/venv
	build/wheel/venv/bin/python -m pip install $(PIP_FLAGS) --constraint constraints.txt build/wheel/*.whl
	mkdir -p build/elsewhere && cd build/elsewhere && PATH="$(CURDIR)/build/wheel/venv/bin:$$PATH" && partdr --help && \
		example=$$(python -c "import warp_partdr; print(warp_partdr.__path__[0])")/assets/example && \
		{ partdr fit "$$example/photo.png" --keypoints "$$example/keypoints.json" --parts "$$example/parts.png" \
			--labels cdcl14 --out fitted 2>stderr.txt || { cat stderr.txt; exit 1; }; } && \
		test -s fitted/body.npz && cat stderr.txt && ! grep -q Traceback stderr.txt

clean:  ## remove what was built, but not .venv
	rm -rf build dist out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/.python:
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or later is needed (make PYTHON=...); this is " + sys.version.split()[0] \
		if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	@touch $@

# The build backend comes first, pinned too, so that pip need not fetch one for itself.
$(VENV)/.installed: $(VENV)/.python pyproject.toml constraints.txt
	@echo "Installing into $(VENV): PyTorch, Warp, VTK and more, a few minutes the first time ..."
	$(INSTALL) setuptools
	$(INSTALL) --no-build-isolation --editable .
	@touch $@

$(VENV)/.installed-demo: $(VENV)/.installed
	$(INSTALL) --no-build-isolation --editable '.[demo]'
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(INSTALL) --no-build-isolation --editable '.[test,dev]'
	@touch $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(INSTALL) --no-build-isolation --editable '.[docs]'
	@touch $@

$(VENV)/.installed-release: $(VENV)/.installed
	$(INSTALL) --no-build-isolation --editable '.[release]'
	@touch $@

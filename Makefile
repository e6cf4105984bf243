# Targets first set up what they need in .venv; nothing has to be installed by hand.
# ARGS is passed on:  make test ARGS="-k laplacian"   make demo ARGS="--help"
# PYTHON names the interpreter to build .venv with:  make setup PYTHON=/path/to/python3.13

BIN := .venv/bin
FITS := import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 13)))

.DEFAULT_GOAL := help
# One BLAS thread: the matrices are small, and threads that wait for a taken core cost thirtyfold.
# Files of tests run side by side, one at a time on each core; the last -n counts, such as in ARGS="-n 0 --pdb".
# Keep compiled tests even if the environment says not to: collecting them then takes half the time.
PYTEST := PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=$${OPENBLAS_NUM_THREADS:-1} $(BIN)/python -m pytest -n auto --dist loadfile

.PHONY: help setup test test-core test-all test-blender-versions mutants fuzz extension docs release page demo demo-oldest lint format benchmarks clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-23s%s\n", $$1, $$2 }' Makefile

setup:  ## create or update .venv (done by the targets that need it, too)
	@for python in "$(PYTHON)" python3.13 python3.11 python3 python; do \
		if "$$python" -c '$(FITS)' >/dev/null 2>&1; then exec "$$python" tools/bootstrap.py $(EXTRAS); fi; \
	done; \
	echo "No Python 3.11 or 3.13 runs here, and bpy (Blender as a Python module) exists for these two only:" \
		"install one, or name it with 'make setup PYTHON=/path/to/python3.13'." >&2; \
	exit 1

test-core: EXTRAS := core
test-core: setup  ## run the core's tests, without Blender (ARGS for pytest)
	$(PYTEST) tests/core $(ARGS)

test: setup  ## run the tests but the slow ones (ARGS for pytest)
	$(PYTEST) $(ARGS)

test-all: setup  ## run all tests, the slow ones too, then the extension's in each version of Blender
	$(PYTEST) --slow $(ARGS)
	$(BIN)/python tools/blender_versions.py

test-blender-versions: setup  ## install the extension into each version of Blender, and test it there (ARGS: some of them)
	$(BIN)/python tools/blender_versions.py $(ARGS)

mutants: setup  ## list small changes of the code that no test detects: make mutants ARGS="zoomout_core/matching"
	$(BIN)/python tools/mutants.py $(ARGS)

extension: EXTRAS := extension
extension: setup  ## build the Blender extension into dist, for this machine (ARGS: other platforms, or --all)
	$(BIN)/python tools/extension.py $(ARGS)

docs: EXTRAS := docs
docs: setup  ## build the documentation into build/docs/html; warnings are errors
	$(BIN)/python tools/documentation.py $(ARGS)

release: EXTRAS := release
release: setup  ## build and check the wheel, the source and the zips, in dist (PROJECT_URL: the public address)
	PROJECT_URL="$(PROJECT_URL)" $(BIN)/python tools/release.py $(ARGS)

page: setup  ## make the animation and the pictures of the extension's page, into dist/page
	$(BIN)/python tools/extension_page.py $(ARGS)

demo: setup  ## match two characters, transfer between them, and print where the results are
	$(BIN)/zoomout demo $(ARGS)

demo-oldest: setup  ## run the demo in Blender 4.2 (Python 3.11), so that demo.blend opens there, too
	$(BIN)/python tools/oldest_demo.py $(ARGS)

fuzz: setup  ## pass broken files to every reader: make fuzz ARGS="--count 100000"
	$(BIN)/python tools/fuzz.py $(ARGS)

lint: setup  ## check format, style and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: setup  ## put the code into its format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

benchmarks: setup  ## make a table or figure: make benchmarks ARGS="NAME --data FOLDER"
	$(BIN)/python -m benchmarks $(ARGS)

clean:  ## remove .venv, caches and build products
	rm -rf .venv .venv-blender build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

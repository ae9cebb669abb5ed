# make fly   sets everything up and flies the embedded site in simulation, GPS off
# make test  sets everything up and passes the tests
# make test-long  the same and all that takes minutes: every scenario, the million filter steps
# make check lint and types
PYTHON ?= python3
BIN := .venv/bin

.PHONY: venv fly test test-long check clean

venv: .venv/.onboard

.venv/.onboard: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "vwnav needs Python 3.11 or newer; try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -e .
	@touch $@

.venv/.dev: .venv/.onboard
	$(BIN)/pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@

# FLY adds options, for example: make fly FLY="--features sift"
# By the wall clock, which waits for nobody: make fly FLY="--realtime"
fly: .venv/.onboard
	$(BIN)/vwnav fly --sim $(FLY)

test: .venv/.dev
	$(BIN)/python -m pytest -n 2 -m "not long"

test-long: .venv/.dev
	$(BIN)/python -m pytest -n 2 -m "long or not long"

check: .venv/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

clean:
	rm -rf .venv build dist

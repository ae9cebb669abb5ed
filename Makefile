# make fly   sets everything up and flies the embedded site in simulation, GPS off
# make test  sets everything up and passes the tests
# make test-long  the same and all that takes minutes: every scenario, the million filter steps
# make test-arm   on an emulated Raspberry Pi 4 and 5 (sets that up; Linux on x86)
# make wheel what is installed on a board, in dist/
# make fuzz  a million hostile MAVLink frames against what hears the link onboard
# make mutants  how many of 300 mutants of vwnav/safety its tests kill; MUTANTS=all takes them all
# make house how the house is built: what a step enters, import chains, sizes
# make check lint and types
PYTHON ?= python3
BIN := .venv/bin

.PHONY: venv fly test test-long test-arm wheel fuzz mutants house check clean

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
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not long"

test-long: .venv/.dev
	$(BIN)/python -m pytest -m alone; alone=$$?; \
	$(BIN)/python -m pytest -n 2 --dist worksteal --hypothesis-profile=searching -m "not alone" \
		&& exit $$alone

# AARCH64 names another folder for the emulated system
AARCH64 ?= .aarch64
test-arm: .venv/.dev
	PYTHON=$(BIN)/python deploy/aarch64.sh $(AARCH64)
	VWNAV_AARCH64=$(AARCH64) $(BIN)/python -m pytest -s -m "long or not long" tests/arm

wheel: .venv/.onboard
	rm -f dist/vwnav-*.whl
	$(BIN)/pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist .

fuzz: .venv/.dev
	$(BIN)/python -m pytest -m long tests/mavlink/test_hostile_frames.py

# JOBS at a time; SEED draws another sample
MUTANTS ?= 300
SEED ?= 1
JOBS ?= 1
mutants: .venv/.dev
	$(BIN)/python tests/mutants.py --count $(MUTANTS) --seed $(SEED) --jobs $(JOBS)

house: .venv/.dev
	$(BIN)/python tests/house.py

check: .venv/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

clean:
	rm -rf .venv build dist mutants

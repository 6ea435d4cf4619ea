# Everything runs in a virtual environment beside the code; `make` alone lists the targets.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: help setup demo test test-slow lint types docs clean
help:
	@echo "make demo       plan the letter A for green VPS; results in out/letter-A"
	@echo "make test       lint, types, tests (make test-slow: the long ones)"
	@echo "make docs       the documentation's site, into out/docs"

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt "torch==2.13.0"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	$(BIN)/wrod compile
	touch $@

# The installation compiles what commands launch; this what programs and tests do, and their bytecode.
# Types are checked, too: `make types` then checks what has changed since, and reports what is wrong
# from what is kept; that is no reason not to set up.
setup: export PYTHONDONTWRITEBYTECODE =
setup: $(STAMP)
	$(BIN)/python tests/compiled.py
	$(BIN)/python -m pytest -qq --collect-only > /dev/null
	@$(MAKE) --silent types > /dev/null 2>&1 || true

demo: $(STAMP)
	$(BIN)/wrod plan letter-A --rod green-vps --out out/letter-A

# Bytecode is kept, whatever is set: tests start processes that would compile all modules each.
test: export PYTHONDONTWRITEBYTECODE =
test: lint types
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m "not slow" -n auto --dist loadfile

test-slow: $(STAMP)
	$(BIN)/python -m pytest -m slow

# Fifty times the hostile inputs that the tests try, and other ones each time; then every file of
# an adversary into every option, and every wrong argument into every public callable; then calls
# of every command with one option, stream, output or surrounding broken: those of a table, and
# drawn ones.
fuzz: $(STAMP)
	WROD_FUZZ=50 OMP_NUM_THREADS=1 $(BIN)/python -m pytest -vv --tb=short -n auto --dist worksteal \
		tests/test_fuzz.py tests/test_bombs.py tests/test_arguments.py
	$(BIN)/python tests/adversary.py --listed --count 10000 --workers $$(nproc)
	$(BIN)/python tests/adversary.py --count 2000 --workers $$(nproc)

# A hundred kills at random moments; every run has to end in the same bytes.
kill-test: $(STAMP)
	$(BIN)/python tests/killing.py --kills 100 --workers 8

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# What mypy makes stays to its end: to search it for garbage takes a quarter of all the time.
types: $(STAMP)
	$(BIN)/python -c "import gc; gc.enable = gc.disable; gc.disable(); \
		from mypy.__main__ import console_entry; console_entry()"

docs: $(STAMP)
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs out/docs

clean:
	rm -rf $(VENV) out build *.egg-info

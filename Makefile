# Everything is set up in .venv by the first target that needs it.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
BUILT  := setup.py pyproject.toml $(wildcard csrc/* csrc/protocols/*)

.PHONY: demo test lint docs bench soak clean

demo: $(VENV)/.built ## make captures of a simulated adapter, decode them, print a table
	$(BIN)/python examples/demo.py

# Hundreds of tests start the command: so its modules are compiled once, and kept.
test: $(VENV)/.test ## run the tests; many wait for others, so four at a time, on two cores too
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 4 --dist worksteal

lint: $(VENV)/.lint ## run the linters
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run -Werror csrc/*.[ch] csrc/*/*.[ch] tests/c/*.[ch] tests/c/guard/*.[ch] bench/*.c examples/*.c

docs: $(VENV)/.docs ## make the documentation in build/docs; warnings are errors
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs

bench: $(VENV)/.bench ## print what is reached and what must be; plot time against size
	$(BIN)/python bench/table.py
	$(BIN)/python bench/growth.py --plot build/growth.png
	$(BIN)/python bench/port.py

soak: $(VENV)/.bench $(VENV)/.test ## an hour of a line at 2 Mbaud for each protocol; 1,000 kills
	$(BIN)/python bench/soak.py
	CANSER_KILLS=1000 $(BIN)/python -m pytest -q -s tests/test_recording_kill.py

clean:
	rm -rf $(VENV) build dist canser.egg-info canser/_core/_lib.*.so canser/_core/_lib.*.pyd

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

# One stamp for each set of packages; all build the extension anew when it changes.
$(VENV)/.built: $(VENV)/bin/python $(BUILT)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(VENV)/.test: $(VENV)/bin/python $(BUILT)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	touch $(VENV)/.built $@

$(VENV)/.bench: $(VENV)/bin/python $(BUILT)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	touch $(VENV)/.built $@

$(VENV)/.docs: $(VENV)/bin/python $(BUILT)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $(VENV)/.built $@

$(VENV)/.lint: $(VENV)/bin/python $(BUILT)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[lint]'
	touch $(VENV)/.built $(VENV)/.test $@

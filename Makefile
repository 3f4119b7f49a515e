# make demo, make test: each sets up what it needs, once, in .venv.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
OUT ?= report

.PHONY: demo test validate bench

demo: $(VENV)/.installed
	$(BIN)/millax fit data_synthetic/kr240_slot.toml --out $(OUT)
	@echo "Open $(OUT)/report.html: measured against fitted traces, residuals, estimates beside the truth."

test: $(VENV)/.installed-test
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/pytest -n 2 --dist worksteal

# Figures of accuracy beside the papers' and beside other programs', some of which only the tests bring.
validate: $(VENV)/.installed-test
	XLA_FLAGS= $(BIN)/pytest -n 2 --dist worksteal -m long
	$(BIN)/python -m benchmarks.validate

# Figures of speed.
bench: $(VENV)/.installed
	$(BIN)/python -m benchmarks.bench --write docs/speed.md

$(VENV):
	$(PYTHON) -m venv $@

$(VENV)/.installed: pyproject.toml | $(VENV)
	@echo "Installing into $(VENV), once; this takes a minute or two."
	$(PIP) install --quiet --editable .
	@touch $@

$(VENV)/.installed-test: pyproject.toml | $(VENV)
	@echo "Installing into $(VENV), once; this takes a minute or two."
	$(PIP) install --quiet --editable ".[test]"
	@touch $@ $(VENV)/.installed

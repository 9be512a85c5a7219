# Each target makes .venv when it is missing; nothing else has to be done first.

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
DEMO := demo-maps

.PHONY: demo test test-slow lint benchmark compare scaling optimum segmentation clean

demo: $(READY)
	rm -rf $(DEMO)
	$(BIN)/elitelanes generate --size 12 12 --method map-elites --seeds 16 --maps 16 --out $(DEMO)

test: $(READY)
	$(BIN)/python -m pytest -n auto --dist loadfile

test-slow: $(READY)
	$(BIN)/python -m pytest -m slow

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

benchmark: $(READY)
	$(BIN)/python experiments/benchmark.py

compare: $(READY)
	$(BIN)/python experiments/compare.py

scaling: $(READY)
	$(BIN)/python experiments/scaling.py

optimum: $(READY)
	$(BIN)/python experiments/optimum.py

segmentation: $(READY)
	$(BIN)/python experiments/segmentation.py

clean:
	rm -rf .venv $(DEMO)

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "elitelanes_jax: expected Python 3.11 or later as $(PYTHON), got $$($(PYTHON) --version 2>&1)"; exit 2; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,experiments,segmentation]'
	touch $(READY)

# Each target makes .venv when it is missing; nothing else has to be done first.

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
DEMO := demo-maps

.PHONY: demo test test-slow proofs-interop lint benchmark compare scaling optimum clean

demo: $(READY)
	rm -rf $(DEMO)
	$(BIN)/elitelanes generate --size 12 12 --method map-elites --seeds 16 --maps 16 --out $(DEMO)

test: $(READY)
	$(BIN)/python -m pytest

test-slow: $(READY)
	$(BIN)/python -m pytest -m slow

# QDax, evosax and pyribs bring some sixty packages: they have an environment of their own.
proofs-interop:
	$(PYTHON) -m venv .venv-interop
	.venv-interop/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
	  -e '.[dev,interop,plots]'
	.venv-interop/bin/python -m pytest tests/test_interop.py

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

clean:
	rm -rf .venv .venv-interop $(DEMO)

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "elitelanes_jax: expected Python 3.11 or later as $(PYTHON), got $$($(PYTHON) --version 2>&1)"; exit 2; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,experiments]'
	touch $(READY)

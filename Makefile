# Every target creates what it needs; nothing has to be installed manually.
VENV := .venv
BIN := $(VENV)/bin
PYTHON ?= python3
INSTALLED := $(VENV)/.installed
AUDIT := $(VENV)/audit/bin

.PHONY: demo test check audit sbom wheel bench tables docs clean

demo: $(INSTALLED)  ## identify a recorded rig, control the corrected machine
	$(BIN)/hframe identify examples/rig_a --out out/demo
	$(BIN)/hframe evaluate pid ppo --machine out/demo/machine.json --randomize none --episodes 32 --html --out out/demo/control
	@echo "open out/demo/report.html, out/demo/control/scorecard.html, pid.png and ppo.png"

test: $(INSTALLED)  ## all tests but the slow ones
	$(BIN)/pytest -n auto --dist worksteal

check: $(INSTALLED) hframe_gym/agents  ## format, lint, docstrings, types, layers, pinned versions and licenses
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo
	$(BIN)/python -m tools.dependencies --check
	$(BIN)/python -m pip check

audit: $(INSTALLED) $(AUDIT)/uv  ## needs the network: every extra resolves with the pins, all are pinned, known vulnerabilities
	mkdir -p out
	$(AUDIT)/uv pip compile -q --all-extras -c constraints.txt --python $(BIN)/python --no-header --no-annotate -o out/resolved.txt pyproject.toml
	$(BIN)/python -m tools.dependencies --resolved out/resolved.txt
	$(AUDIT)/pip-audit --strict --disable-pip --no-deps -r constraints.txt

sbom: $(INSTALLED) $(AUDIT)/uv  ## software bill of materials of the environment: dist/sbom.cdx.json (CycloneDX), with licenses
	mkdir -p dist
	$(AUDIT)/cyclonedx-py environment --pyproject pyproject.toml --mc-type library --output-reproducible -o dist/sbom.cdx.json $(BIN)/python

wheel: $(INSTALLED)  ## wheel and source distribution in dist/, checked, installed in empty environments and used
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[release]'
	rm -rf dist
	$(BIN)/python -m build
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl
	$(BIN)/pytest -m slow -s tests/test_wheel.py

bench: $(INSTALLED)  ## all numbers of RESULTS.md
	$(BIN)/pip install -q -c constraints.txt -e '.[bench,ray]'
	$(BIN)/python -m benchmarks

tables: $(INSTALLED)  ## generated tables of README.md, RESULTS.md and docs/, and docs/effects.md
	$(BIN)/python -m tools.tables

docs: $(INSTALLED) hframe_gym/agents  ## the documentation site, out/site; fails at every warning and outdated table
	$(BIN)/python -m tools.tables --check
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "open out/site/index.html"

# mypy and import-linter look for hframe_gym.agents beside the package's other folders.
hframe_gym/agents:
	ln -s ../agents $@

$(AUDIT)/uv: constraints.txt
	$(PYTHON) -m venv $(VENV)/audit
	$(AUDIT)/pip install -q --disable-pip-version-check -c constraints.txt cyclonedx-bom pip-audit uv
	touch $@

clean:
	rm -rf $(VENV) out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache hframe_gym/agents

# torch comes first and separately: the requirement of another package would install the build with GPU libraries.
$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt torch==2.13.0
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

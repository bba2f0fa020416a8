# Every target creates what it needs; nothing has to be installed manually.
VENV := .venv
BIN := $(VENV)/bin
PYTHON ?= python3
AUDIT := $(VENV)/audit/bin

.PHONY: demo test slow check installed audit sbom wheel bench tables docs clean

# tools/tasks.py defines these four and the installation, for systems without make as well: python -m tools.tasks --help
demo test slow check:
	$(PYTHON) -m tools.tasks $@

installed:  ## everything in .venv
	@$(PYTHON) -m tools.tasks install

audit: installed $(AUDIT)/uv  ## needs the network: every extra resolves with the pins, all are pinned, known vulnerabilities
	mkdir -p out
	$(AUDIT)/uv pip compile -q --all-extras -c constraints.txt --python $(BIN)/python --no-header --no-annotate -o out/resolved.txt pyproject.toml
	$(BIN)/python -m tools.dependencies --resolved out/resolved.txt
	$(AUDIT)/pip-audit --strict --disable-pip --no-deps -r constraints.txt

sbom: installed $(AUDIT)/uv  ## software bill of materials of the environment: dist/sbom.cdx.json (CycloneDX), with licenses
	mkdir -p dist
	$(AUDIT)/cyclonedx-py environment --pyproject pyproject.toml --mc-type library --output-reproducible -o dist/sbom.cdx.json $(BIN)/python

wheel: installed  ## wheel and source distribution in dist/, checked, installed in empty environments and used
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[release]'
	rm -rf dist
	$(BIN)/python -m build
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl
	$(BIN)/pytest -m slow -s tests/test_wheel.py

bench: installed  ## all numbers of RESULTS.md
	$(BIN)/pip install -q -c constraints.txt -e '.[bench,ray]'
	$(BIN)/python -m benchmarks

tables: installed  ## generated tables of README.md, RESULTS.md and docs/, and docs/effects.md
	$(BIN)/python -m tools.tables

docs: installed  ## the documentation site, out/site; fails at every warning and outdated table
	$(BIN)/python -m tools.tables --check
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "open out/site/index.html"

$(AUDIT)/uv: constraints.txt
	$(PYTHON) -m venv $(VENV)/audit
	$(AUDIT)/pip install -q --disable-pip-version-check -c constraints.txt cyclonedx-bom pip-audit uv
	touch $@

clean:
	rm -rf $(VENV) out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache hframe_gym/agents

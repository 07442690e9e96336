# make demo, make test and make docs do all the set-up themselves.
BIN := .venv/bin
READY := .venv/.gtau-installed
TOOLS := .venv/.gtau-tools-installed
SITE := .venv/.gtau-docs-installed
PYTHONS := python3.13 python3.12 python3.11 python3.14 python3
# Bytecode is made of what is imported: to make that of all packages takes half of the time of pip.
INSTALL = $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt
SUPPORTED := import ensurepip, sys; sys.exit(sys.version_info[:2] < (3, 11))

# Where bytecode is not kept, each of the many processes that tests start compiles the package again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test tests slow lint docs docs-zip pages clean

demo: $(READY)
	$(BIN)/gtau demo --out demo
	@echo "(gtau is in $(BIN): '. $(BIN)/activate' puts it on the path)"

test: lint tests

tests: $(TOOLS)
	@$(BIN)/python -c "import gtau; m = gtau.InverseDynamics(gtau.load_robot('five-bar')); m.regressor([0.1, 0.2], [0, 0], [0, 0])" # compiled once
	$(BIN)/pytest -n auto --dist loadfile -m "not slow"

slow: $(TOOLS)
	$(BIN)/pytest -n auto --dist loadfile -m slow

lint: $(TOOLS)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

# The site, in build/site. GTAU_GALLERY=skip leaves the scripts of the gallery out.
docs: $(SITE)
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/site
	$(BIN)/python docs/check_links.py build/site

# Pages and tables that are made from the code.
pages: $(TOOLS)
	for program in docs/make_*.py; do $(BIN)/python $$program || exit 1; done

docs-zip: docs
	$(BIN)/python -m zipfile -c build/gtau-docs.zip build/site/
	@echo "build/gtau-docs.zip: unpack it and open site/index.html, no network needed"

$(READY): pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing gtau into .venv (once, about a minute)"
	$(INSTALL) -e .
	@touch $@

$(TOOLS): pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing what the tests need into .venv (once, a few minutes)"
	$(INSTALL) 'pip>=25.1'
	$(INSTALL) -e '.[test]' --group dev
	@touch $(READY) $@

$(SITE): $(READY)
	@echo "installing what the site needs into .venv (once, a minute)"
	$(INSTALL) -e '.[docs]'
	@touch $@

$(BIN)/python:
	@for python in $(PYTHONS); do \
	    if $$python -c '$(SUPPORTED)' 2>/dev/null; then exec $$python -m venv .venv; fi; \
	done; \
	echo "gtau needs Python 3.11 or later with venv (Debian: python3-venv); install one, or name it: make $(MAKECMDGOALS) PYTHONS=/path/to/python" >&2; \
	exit 1

clean:
	rm -rf .venv demo dist build docs/gallery docs/lookup/api .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	find src tests benchmarks examples -name __pycache__ -type d -prune -exec rm -rf {} +

# make demo and make test do all the set-up themselves.
BIN := .venv/bin
READY := .venv/.gtau-installed
TOOLS := .venv/.gtau-tools-installed
PYTHONS := python3.13 python3.12 python3.11 python3.14 python3
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
SUPPORTED := import ensurepip, sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 15))

# Where bytecode is not kept, each of the many processes that tests start compiles the package again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test slow lint clean

demo: $(READY)
	$(BIN)/gtau demo --out demo
	@echo "(gtau is in $(BIN): '. $(BIN)/activate' puts it on the path)"

test: lint
	$(BIN)/pytest -n auto --dist loadfile -m "not slow"

slow: $(TOOLS)
	$(BIN)/pytest -n auto --dist loadfile -m slow

lint: $(TOOLS)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

$(READY): pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing gtau into .venv (once, about a minute)"
	$(INSTALL) -e .
	@touch $@

$(TOOLS): $(READY)
	@echo "installing what the tests need into .venv (once, a few minutes)"
	$(INSTALL) -e '.[test,dev]'
	@touch $@

$(BIN)/python:
	@for python in $(PYTHONS); do \
	    if $$python -c '$(SUPPORTED)' 2>/dev/null; then exec $$python -m venv .venv; fi; \
	done; \
	echo "gtau needs Python 3.11 to 3.14 with venv (Debian: python3-venv); install one, or name it: make $(MAKECMDGOALS) PYTHONS=/path/to/python" >&2; \
	exit 1

clean:
	rm -rf .venv demo dist build .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	find src tests benchmarks examples -name __pycache__ -type d -prune -exec rm -rf {} +

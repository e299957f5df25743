# Everything happens in .venv, made with whatever Python 3.11 or later is at hand. A bare Debian has no
# ensurepip, so the venv is made without pip, and the system's pip installs into it.

PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin

# Many tests wait for a time or for another process, so two run for each core. `make test WORKERS=1` is
# for a machine with little memory: each takes about 250 MB.
WORKERS ?= $(shell $(PYTHON) -c 'import os; print(2 * (os.cpu_count() or 1))')
IN_PARALLEL := --numprocesses $(WORKERS) --dist worksteal

# Tests start hundreds of processes; without byte code each would compile all it imports again.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help install demo collected test quick coverage mutants lint test-peers truth format clean docs man zipapp dist

help:
	@echo "make demo        install into .venv and run mbtool demo"
	@echo "make test        install what tests need, then lint, types, import contracts, tests"
	@echo "make quick       ruff and the quick tests: under a minute"
	@echo "make coverage    which lines no test runs; takes several times as long as the tests"
	@echo "make mutants     change the code in 60 small ways, list the changes that no test notices"
	@echo "make test-peers  install mbpoll, tshark and libmodbus (Debian), run the tests that need them"
	@echo "make truth       compare every capture made by others with its truth, as a table"
	@echo "make docs        run the commands of the pages, build the site into build/site"
	@echo "make man         write the manual page build/mbtool.1 from the help texts"
	@echo "make zipapp      one file with all dependencies, build/mbtool.pyz"
	@echo "make dist        wheel and source archive in dist/"
	@echo "make install     install into .venv only: then .venv/bin/mbtool"
	@echo "make format      let ruff put the code in order"

$(VENV)/bin/python:
	$(PYTHON) -m venv --without-pip $(VENV)

$(VENV)/installed: $(VENV)/bin/python pyproject.toml
	$(PYTHON) -m pip --python $(RUN)/python install --quiet --editable .
	@touch $@

$(VENV)/installed-test: $(VENV)/installed
	$(PYTHON) -m pip --python $(RUN)/python install --quiet --editable '.[test]'
	@touch $@

install: $(VENV)/installed

demo: install
	$(RUN)/mbtool demo

lint: $(VENV)/installed-test
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/mypy
	$(RUN)/lint-imports

# Collects the tests once, so that the processes of `make test` find them compiled: each would compile
# all 600 modules itself.
collected: $(VENV)/installed-test
	$(RUN)/pytest --collect-only -qq > /dev/null

# Hundreds of tests wait for other processes, which a busy machine may stop for seconds. What fails is run
# once more, alone; the output of the first run names it, and it is a fault to mend all the same.
test: $(VENV)/installed-test
	$(MAKE) --jobs=2 --output-sync=target lint collected
	$(RUN)/pytest $(IN_PARALLEL) || { \
		test $$? -eq 1 && $(RUN)/pytest --last-failed --last-failed-no-failures none; }

quick: $(VENV)/installed-test
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/pytest --numprocesses auto --quick

coverage: $(VENV)/installed-test
	COVERAGE_FILE=$(VENV)/coverage $(RUN)/pytest $(IN_PARALLEL) --cov --cov-report=term:skip-covered

mutants: $(VENV)/installed-test
	nice -n 10 $(RUN)/python -m tests.mutants

test-peers: $(VENV)/installed-test
	sudo=$$(test $$(id -u) = 0 || echo sudo); \
	$$sudo apt-get update -qq && \
	$$sudo env DEBIAN_FRONTEND=noninteractive apt-get install -qq -y mbpoll tshark libmodbus-dev gcc
	$(RUN)/pytest -m peers

truth: $(VENV)/installed-test
	$(RUN)/python -m tests.differential.truth
	$(RUN)/python -m tests.differential.inventory_truth
	$(RUN)/python -m tests.differential.conversions

$(VENV)/installed-docs: $(VENV)/installed
	$(PYTHON) -m pip --python $(RUN)/python install --quiet --editable '.[docs]'
	@touch $@

docs: $(VENV)/installed-docs $(VENV)/installed-test
	$(RUN)/python -m tests.docs.console
	$(RUN)/python -m tests.docs.site

man: install
	@mkdir -p build
	$(RUN)/python -m tests.docs.man_page > build/mbtool.1

# The packages of one Python and system, as some hold machine code.
zipapp:
	rm -rf build/zipapp && mkdir -p build/zipapp
	$(PYTHON) -m pip install --quiet --target build/zipapp/packages '.[watch]'
	cp tests/docs/zipapp_main.py build/zipapp/__main__.py
	$(PYTHON) -m zipapp build/zipapp --compress --python '/usr/bin/env python3' --output build/mbtool.pyz

dist: install
	rm -rf dist
	$(PYTHON) -m pip --python $(RUN)/python install --quiet build
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) $(RUN)/python -m build --quiet

format: $(VENV)/installed-test
	$(RUN)/ruff check --fix .
	$(RUN)/ruff format .

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

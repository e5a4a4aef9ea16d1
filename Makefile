# What a person or a machine runs. Needs Python 3.11 or newer and make; the rest is set up in .venv.

PYTHON ?= python3
UV ?= uv
# Test processes: one more than cores, since some tests wait for a server, a browser or a cluster.
WORKERS ?= $(shell echo $$(($$(nproc 2>/dev/null || getconf _NPROCESSORS_ONLN) + 1)))
BIN := .venv/bin

.DEFAULT_GOAL := help
.PHONY: help install demo test test-long coverage lint docs bench evidence serve image-check lock clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1	\2/p' $(MAKEFILE_LIST) | expand -t 16

install: .venv/.installed ## set up .venv

# requirements.lock holds every version with its hash, the build backend's too: nothing else is fetched.
.venv/.installed: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed: make PYTHON=python3.11 ..." if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .
	@touch $@

demo: .venv/.installed ## fit a bundled table with all models and write demo/report.html
	$(BIN)/brdf-fitter demo --out demo

# Each core has a test process already: more threads of the linear algebra only stand in each other's way.
# Bytecode is kept even where the environment forbids it: rewriting the assertions of all tests anew is half of
# what each test process takes to collect them.
PYTEST := OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

test: .venv/.installed ## run the tests but for the long ones; ARGS="tests/cli -k fit" for some, long ones among them
	$(PYTEST) $(or $(ARGS),-m "not long")

# Whole paths through page, server, batch and documents, processes that are killed, statistics, measured tables.
test-long: .venv/.installed ## run the long tests
	$(PYTEST) -m long

coverage: .venv/.installed ## run the tests and count the branches they take, into build/coverage
	$(PYTEST) --cov --cov-report=html:build/coverage --cov-report=term:skip-covered $(ARGS)

lint: .venv/.installed ## check style and types
	$(BIN)/ruff check .
	$(BIN)/basedpyright

bench: .venv/.installed ## measure speed; ARGS="--quick --only fit" for a part, --out FILE for the document
	$(BIN)/python -m tests.bench $(ARGS)

# What builds the pages is locked apart: neither the product nor its tests need it.
.venv/.docs: .venv/.installed docs/requirements.lock
	$(BIN)/python -m pip install --quiet --require-hashes -r docs/requirements.lock
	@touch $@

docs: .venv/.docs ## build the documentation into build/docs; warnings are errors
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet -b html -d build/docs.cache docs build/docs
	@echo "build/docs/index.html"

# The whole takes hours with the global optimum, 40 to 60 minutes without (--study chooses); --share 0.02 --seed fresh is a sample of it.
evidence: .venv/.installed ## run the long studies into docs/evidence.md; ARGS="--study NAME --share 0.02" for a sample
	$(BIN)/python -m tests.evidence $(or $(ARGS),--write)

serve: .venv/.installed ## start the HTTP service on http://127.0.0.1:8000
	$(BIN)/brdf-fitter serve $(ARGS)

# Root and debootstrap; ARGS="--lend /etc/pip.conf" where pip needs something of this machine.
image-check: ## do the Dockerfile's steps without a container engine
	$(PYTHON) -m tests.image --work $(or $(IMAGE),/var/tmp/brdf-fitter-image) $(ARGS)

lock: ## resolve requirements.lock and docs/requirements.lock again (needs uv)
	$(UV) pip compile --quiet --universal --generate-hashes --no-emit-index-url --python-version 3.11 \
		--no-header pyproject.toml --group dev --extra renderers -o requirements.lock
	$(UV) pip compile --quiet --universal --generate-hashes --no-emit-index-url --python-version 3.11 \
		--no-header --group docs -c requirements.lock -o docs/requirements.lock

clean: ## remove everything that make has made
	rm -rf .venv .cache demo build dist .hypothesis .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

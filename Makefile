# make run: set up and start. make test: set up and run the tests. make help: the rest.

SOURCE ?=
PRESET ?=
OUT ?= out

# Another environment's packages (a sourced ROS workspace, say) must not reach this one.
unexport PYTHONPATH
export PYTHONNOUSERSITE = 1

.PHONY: run test test-long test-newest-realsense lint format setup guide pictures release lock clean help
.DEFAULT_GOAL := help

run: setup guide  ## start the application, at first on the simulator; without a display do the same job headless, into out/
	@scripts/run.sh "$(SOURCE)" "$(PRESET)" "$(OUT)"

test: setup  ## run the tests offscreen in three processes
	@scripts/test.sh

test-long: setup  ## run the soaks and the long random tests
	@scripts/test.sh long

test-newest-realsense: setup  ## run the tests of the live cameras with the newest camera driver
	@scripts/test_newest_realsense.sh

lint: setup  ## ruff with its security rules, its formatter, mypy, the import rules, known vulnerabilities where the network allows
	@scripts/lint.sh

format: setup  ## let ruff order imports and format
	@.venv/bin/ruff check --fix --quiet . && .venv/bin/ruff format --quiet .

setup:  ## system libraries, .venv, the locked packages; returns at once when all is there
	@PYTHON="$(PYTHON)" scripts/setup.sh

guide: app/guide/index.html  ## build the guide that Help > Documentation opens, into app/guide

app/guide/index.html: docs/mkdocs.yml $(wildcard docs/guide/*.md docs/guide/images/*) | setup
	@NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --quiet --config-file docs/mkdocs.yml

pictures: setup  ## make the pictures of README and guide from the program itself
	@QT_QPA_PLATFORM=offscreen .venv/bin/python scripts/make_pictures.py

release: setup  ## audit the locked packages, then build wheel and sdist into dist/
	@scripts/audit.sh && .venv/bin/python -m build --no-isolation --outdir dist

lock: setup  ## write requirements.lock from the ranges in pyproject.toml
	@.venv/bin/uv pip compile pyproject.toml --quiet --all-extras --generate-hashes --universal --python-version 3.11 \
	  --no-emit-index-url --no-header --output-file requirements.lock

clean:  ## remove .venv and everything that was made
	rm -rf .venv .realsense-newest .typing app/guide out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

help:
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1\t\2/p' Makefile | expand -t 30

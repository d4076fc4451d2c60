#!/bin/sh
set -eu
bin=.venv/bin
$bin/ruff check .
$bin/ruff format --check .
$bin/mypy -p tactune.core -p tactune.widgets -p tactune.app
$bin/lint-imports

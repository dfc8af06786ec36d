# make run: set up and run the main job in a small size.   make test: set up and pass the checks and tests.
BIN := .venv/bin
RECORDINGS ?=

.PHONY: setup lock run spot test lint clean

setup: .venv/.installed

.venv/.installed: requirements.lock pyproject.toml
	@command -v python3.11 >/dev/null || { echo "Python 3.11 is needed and python3.11 is not on the PATH."; exit 1; }
	python3.11 -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check uv
	$(BIN)/uv pip sync --quiet --python $(BIN)/python --require-hashes requirements.lock
	$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --editable .
	touch $@

lock:  ## renew requirements.lock from pyproject.toml
	$(BIN)/uv pip compile --quiet --python-version 3.11 --generate-hashes --no-emit-index-url --no-header --group dev pyproject.toml -o requirements.lock

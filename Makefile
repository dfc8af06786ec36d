# make run: set up and run the main job in a small size.   make test: set up and pass the checks and tests.
BIN := .venv/bin
SOURCE ?= virtual
RECORDINGS ?=
HOST ?= 127.0.0.1
PREFECT_PORT ?= 4200
MLFLOW_PORT ?= 5000
# Where Python is told to write no bytecode, every one of the many processes would compile all of its imports again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup run test lint docs lock up down clean

setup: .venv/.installed  ## flows and tasks are in no wheel: the .pth file makes the folder of the project importable

.venv/.installed: requirements.lock pyproject.toml
	@command -v python3.11 >/dev/null || { echo "Python 3.11 is needed, as python3.11 on the PATH."; exit 1; }
	python3.11 -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	$(BIN)/uv pip sync --quiet --compile-bytecode --python $(BIN)/python --require-hashes requirements.lock
	$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --editable .
	@echo "$(CURDIR)" > "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/simgap-pipeline.pth"
	@touch $@

run: setup  ## the main job in a small size; SOURCE=spot RECORDINGS=folder for recordings of one's own
	$(BIN)/python -m flows.reproduce $(SOURCE) --overrides pipelines/small.yaml --workspace sweeps/small \
		$(if $(RECORDINGS),--recordings $(RECORDINGS))
	$(BIN)/python -m flows.sealed.prove development --overrides pipelines/sealed/small.yaml --workspace sweeps/small

test: setup lint  ## checks and tests; long tests only where what they depend on has changed since they last passed
	$(BIN)/python -m pytest -m "not long"
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/dvc repro pipelines/long_tests/dvc.yaml

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

docs: setup  ## the documentation site, in site/; index.html opens in a browser without a server
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

up: setup  ## Prefect's and MLflow's pages and what is started from them, on this machine alone; logs in logs/
	$(BIN)/python -m flows.servers up --host $(HOST) --prefect-port $(PREFECT_PORT) --mlflow-port $(MLFLOW_PORT)

down:  ## stop what `make up` started
	$(BIN)/python -m flows.servers down

lock:  ## renew requirements.lock from pyproject.toml
	$(BIN)/uv pip compile --quiet --python-version 3.11 --generate-hashes --no-emit-index-url --no-header \
		--extra pipeline --group dev pyproject.toml -o requirements.lock

clean:  ## remove what runs left, but for reports and DVC's cache
	rm -rf sweeps site .prefect mlruns mlflow.db*

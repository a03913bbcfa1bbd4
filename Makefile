# make demo       three drones fly the paper's experiment in this terminal
# make test       lint, types, import contracts, tests (about 10 minutes)
# make test-long  what takes longer
SHELL := bash
export PYTHON ?=
.PHONY: demo test test-long lint clean
DEMO_ARGS ?=

demo:
	@.ci/setup all
	@exec .venv/bin/covey demo $(DEMO_ARGS)

lint:
	@.ci/setup dev
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/lint-imports --no-cache

test: lint
	.venv/bin/pytest -m "not long" -n 2 --dist loadgroup

test-long:
	@.ci/setup dev
	.venv/bin/pytest -m long --timeout 1800

clean:
	rm -rf .venv build *.egg-info

# make demo             three drones fly the paper's experiment in this terminal
# make test             lint, types, import contracts and every test that needs no real time (five minutes on two cores, eight the first time)
# make test-realtime    tests with processes, sockets and terminals
# make test-long        tests that take longer than that
# make test-px4 PX4_BUILD=PX4/build/px4_sitl_default    real PX4s, if you have a build of one: docs/px4-sitl.md
# make wheel            dist/covey-VERSION-py3-none-any.whl: Covey without a clone
# make docs             the pages of docs/ as a site with search, in .venv/site
# make pins             write requirements/*.txt anew: the newest libraries that pyproject.toml allows, with hashes
# make bench-NAME       one benchmark, with options in ARGS; make bench lists them
SHELL := bash
export PYTHON ?=
unexport PYTHONDONTWRITEBYTECODE  # each process of the tests would compile everything anew
.PHONY: demo test test-realtime test-long test-px4 lint types style compiled bench wheel docs pins clean
DEMO_ARGS ?=
ARGS ?=

demo:
	@.ci/setup all
	@exec .venv/bin/covey demo $(DEMO_ARGS)

lint:
	@.ci/setup dev
	@$(MAKE) --no-print-directory -j 2 types style

types:
	.venv/bin/mypy

style:
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/lint-imports --no-cache

# each on one core: mypy, and beside it the other checks and then the compilation of the law and of the emulator, and on a
# clean clone of the test files, which otherwise each worker would compile
compiled: style
	@.venv/bin/covey simulate swap2 --seeds 0 --law orca > .venv/compiled.log
	@test -e .venv/collected.log || .venv/bin/pytest --collect-only -q -m "not long" > .venv/collected.log || true

# Three workers for two cores: the tests of the console wait for their timers nearly half of the time. Beside others on
# a busy computer, an agent's loop or a console may stall for a second. So what failed runs once more, alone; what fails
# alone too has failed.
define run_tests
.venv/bin/pytest -m $(1) -n 3 --dist loadgroup --no-loadscope-reorder || { [ $$? = 1 ] && \
  echo "Once more, alone, what failed beside others:" && \
  .venv/bin/pytest -m $(1) --last-failed --last-failed-no-failures none; }
endef

test:
	@.ci/setup dev
	@$(MAKE) --no-print-directory -j 2 types compiled
	$(call run_tests,"not long and not realtime")

test-realtime:
	@.ci/setup dev
	$(call run_tests,"realtime and not long")

test-long:
	@.ci/setup dev
	.venv/bin/pytest -m long --timeout 1800

test-px4:
	@.ci/setup dev
	PX4_BUILD=$(PX4_BUILD) .venv/bin/pytest tests/px4 -m long -rs -v

bench:
	@.ci/setup dev
	@.venv/bin/python -m tests.bench --help

bench-%:
	@.ci/setup dev
	@exec .venv/bin/python -m tests.bench $* $(ARGS)

wheel:
	@.ci/setup all
	@.venv/bin/python -m pip wheel -q --no-deps --no-build-isolation -w dist . && ls dist/covey-*.whl

docs:
	@.ci/setup all
	@.ci/setup docs
	@.venv/bin/mkdocs build --quiet --config-file .ci/mkdocs.yml --site-dir ../.venv/site
	@echo "Open .venv/site/index.html in a browser."

# one resolution for all systems and for Python 3.11 and newer; setuptools builds Covey itself
PIN = .venv/pins/bin/uv pip compile --quiet --upgrade --universal --python-version 3.11 --generate-hashes \
  --custom-compile-command "make pins" requirements/build.in

pins:
	@.ci/setup dev
	@.venv/bin/python -m venv .venv/pins && .venv/pins/bin/pip install -q 'uv>=0.13,<1'
	$(PIN) pyproject.toml --extra all --group dev -o requirements/dev.txt
	$(PIN) pyproject.toml --extra all --constraint requirements/dev.txt -o requirements/all.txt
	$(PIN) pyproject.toml --constraint requirements/dev.txt -o requirements/base.txt
	$(PIN) --group docs --constraint requirements/dev.txt -o requirements/docs.txt

clean:
	rm -rf .venv build dist *.egg-info

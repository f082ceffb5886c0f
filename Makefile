# Shortcuts; each line is the command itself. PYTHON is the environment that `pip install -e '.[dev]'` went into.
PYTHON ?= .venv/bin/python
CMD ?= bash -c 'ip -details link show vcan0'

MINUTES ?= 10
#: what `make quick` runs: the stages from frames to forces, no slow test, no guest machine
QUICK ?= $(patsubst %,tests/decode/test_%.py,compiled_signals decoder identifiers transport value_tables) \
	tests/grid tests/vehicle

.PHONY: demo quick test lint docs site deb fuzz vcan guest
demo:            # a bundled drive, live view, no hardware
	$(PYTHON) -m canest demo
quick:           # under 30 s on an idle machine with two cores, while you work
	$(PYTHON) -m pytest -m "not slow and not vcan" $(QUICK)
test:            # all of it: tests, linters, types, the guest machine
	$(PYTHON) -m pytest -n 3
lint:            # ruff, mypy, imports of the benchmarks
	$(PYTHON) -m pytest tests/test_quality.py
docs:            # writes docs/config.md anew, then checks prose, links and commands of the pages
	$(PYTHON) tools/config_page.py --write
	$(PYTHON) tools/commands_page.py --write
	$(PYTHON) tools/prose.py
	$(PYTHON) -m pytest tests/docs
site:            # the documentation as a site in build/site; every warning is an error
	$(PYTHON) tools/build_site.py
deb:             # a Debian package in dist/, without root
	$(PYTHON) tools/make_deb.py
fuzz:            # nightly: every parser for MINUTES; what is found joins tests/fuzz/found (needs the extra fuzz)
	nice $(PYTHON) benchmarks/fuzz.py --minutes $(MINUTES)
vcan:            # what needs a real SocketCAN bus
	$(PYTHON) -m pytest tests/vcan
guest:           # any command beside a real vcan0: make guest CMD="candump -n 1 vcan0"
	PYTHONPATH=tests/vcan $(PYTHON) -m guest $(GUEST_OPTIONS) -- $(CMD)

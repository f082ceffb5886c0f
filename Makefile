# Shortcuts; each line is the command itself. PYTHON is the environment that `pip install -e '.[dev]'` went into.
PYTHON ?= .venv/bin/python
CMD ?= bash -c 'ip -details link show vcan0'

MINUTES ?= 10

.PHONY: demo test lint fuzz vcan guest
demo:            # a bundled drive, live view, no hardware
	$(PYTHON) -m canest demo
test:            # all of it: tests, linters, types, the guest machine
	$(PYTHON) -m pytest -n 3
lint:
	$(PYTHON) -m pytest tests/test_quality.py
fuzz:            # nightly: every parser for MINUTES; what is found joins tests/fuzz/found (needs the extra fuzz)
	nice $(PYTHON) benchmarks/fuzz.py --minutes $(MINUTES)
vcan:            # what needs a real SocketCAN bus
	$(PYTHON) -m pytest tests/vcan
guest:           # any command beside a real vcan0: make guest CMD="candump -n 1 vcan0"
	PYTHONPATH=tests/vcan $(PYTHON) -m guest $(GUEST_OPTIONS) -- $(CMD)

# make demo   set up what the program needs and calibrate sample_data/recording.bin
# make test   set up the developers' tools as well and run the test suite
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
PLAIN  := $(VENV)/.installed
READY  := $(VENV)/.ready
PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# exact versions; `make LOCK=` takes the newest that pyproject.toml allows
LOCK   := requirements.lock
DEMO   := demo
# otherwise each process that a test starts compiles the package again, and each worker all tests
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup demo test nightly fuzz faults validation oldest oldest-ready audit lint docs firmware browser browser-ready bench bench-scale bench-peers snakemake sample-data figure screenshots clean

setup: $(READY)

# installs the versions of the lock, or others where these cannot be had, such as for a newer Python
define locked
$(if $(LOCK),$(PIP) --constraint $(LOCK) $(1) \
	  || { echo "The versions of $(LOCK) cannot be installed here; others are."; $(PIP) $(1); },$(PIP) $(1))
endef

$(PLAIN): pyproject.toml $(LOCK)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "accelcal needs Python 3.11 or newer: make PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@# --no-compile: Python compiles the few modules that are used when they are first imported
	$(call locked,--no-compile --editable .)
	touch $@

$(READY): $(PLAIN)
	$(call locked,--editable '.[dev]')
	$(PIP) $(if $(LOCK),--constraint $(LOCK)) --editable '.[oracles]' \
	  || echo "The other readers that some tests compare with do not install here; those tests are skipped."
	touch $@

demo: $(PLAIN)
	$(BIN)/accelcal inspect sample_data/recording.bin
	$(BIN)/accelcal calibrate sample_data/recording.bin --output-dir $(DEMO) --force --html
	@echo "Written: $(DEMO)/recording.calibrated.parquet and $(DEMO)/recording.calibration.json"
	@echo "The recording before and after, for a browser:"
	@echo "$(CURDIR)/$(DEMO)/recording.html"

test: $(READY)
	$(BIN)/python -m pytest -n auto --dist worksteal -m 'not nightly'

nightly: $(READY)
	ACCELCAL_HYPOTHESIS=searching $(BIN)/python -m pytest -n auto --dist loadfile -m nightly
	ACCELCAL_HYPOTHESIS=searching $(BIN)/python -m pytest -n auto --dist loadfile -m 'not nightly'

# ACCELCAL_FUZZ mutants of all formats together, and one in a hundred as many of each kind of our own files
fuzz: $(READY)
	ACCELCAL_FUZZ=$${ACCELCAL_FUZZ:-100000} $(BIN)/python -m tests.fuzz

# accelcal beside other methods, coverage of intervals and hours of wear, measured here, as one page: build/validation.md;
# actipy and scikit-digital-health take part after `make bench_data/peers/.ready`
validation: $(READY)
	$(BIN)/python -m tools.validation

# the table of docs/reliability.md: FAULTS calls of each operation fail in turn (3; 0: all, which takes hours)
faults: $(READY)
	$(BIN)/python -m tests.faults $(FAULTS)

# the oldest versions of the dependencies that pyproject.toml allows, from wheels, in an environment of their own
OLDEST := bench_data/oldest
oldest: oldest-ready
	$(OLDEST)/bin/python -m pytest -n auto -m 'not nightly' tests/optimize/test_contract.py \
	  tests/formats/test_contract.py tests/cli/test_calibrate.py tests/cli/test_simulate.py tests/pages/test_recording_page.py \
	  tests/output tests/parquet tests/exports tests/collect --deselect tests/parquet/test_row_groups.py

oldest-ready: $(OLDEST)/.ready

$(OLDEST)/.ready: pyproject.toml
	rm -rf $(OLDEST)
	$(PYTHON) -m venv $(OLDEST)
	$(PYTHON) tools/oldest.py > $(OLDEST)/requirements.txt
	$(OLDEST)/bin/python -m pip install --quiet --only-binary :all: -r $(OLDEST)/requirements.txt \
	  pytest pytest-xdist hypothesis jsonschema
	touch $@

# what is installed against published advisories; numpy is always installed, so a service that does not know it was not reached
AUDIT := bench_data/audit
audit: $(READY)
	$(PYTHON) -m venv $(AUDIT)
	$(AUDIT)/bin/python -m pip install --quiet pip-audit
	@$(AUDIT)/bin/pip-audit --path $$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))') > $(AUDIT)/report.txt 2>&1; \
	  code=$$?; cat $(AUDIT)/report.txt; \
	  if grep -qE '^numpy .*could not be audited|ConnectionError|Max retries' $(AUDIT)/report.txt; then \
	    echo "make audit: the service of published advisories cannot be reached; nothing was compared."; exit 1; \
	  fi; exit $$code

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy --platform win32
	$(BIN)/mypy --platform darwin
	$(BIN)/python tools/lint_words.py

# the pages and the documentation site in a real Chromium; screenshots are in build/browser/screenshots
BROWSER := build/browser
browser: browser-ready docs
	ACCELCAL_CHROMIUM="$$(cat $(BROWSER)/chromium)" ACCELCAL_SCREENSHOTS=$(CURDIR)/$(BROWSER)/screenshots \
	  ACCELCAL_AXE=$(CURDIR)/$(BROWSER)/node_modules/axe-core/axe.min.js \
	  $(BIN)/python -m pytest -n 0 tests/browser

browser-ready: $(READY)
	sh tools/set_up_browser.sh $(BROWSER) $(BIN)/python

# the documentation site in build/docs; a warning, such as a link that leads nowhere, is an error
docs: $(PLAIN)
	$(PIP) --editable '.[docs]'
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs
	@echo "$(CURDIR)/build/docs/index.html"

# flash, RAM and time of firmware/accelcal.h on simulated microcontrollers (docs/flash-format.md#calibrating-on-a-microcontroller)
firmware: $(PLAIN)
	$(BIN)/python -m firmware.measure

bench: $(READY)
	$(BIN)/python -m bench $(BENCH)

# a study of 100 000 recordings (docs/cluster.md#a-study-of-100-000-recordings): about 10 minutes
bench-scale: $(READY)
	$(BIN)/python -m bench.scale $(BENCH)

bench-peers: $(READY) bench_data/peers/.ready
	$(BIN)/python -m bench --peers bench_data/peers/bin/python $(BENCH)

bench_data/peers/.ready:
	$(PYTHON) -m venv bench_data/peers
	bench_data/peers/bin/python -m pip install --quiet actipy scikit-digital-health pyarrow
	touch $@

# runs examples/Snakefile with the real program and compares the result with that of a study run as a whole
SNAKE := bench_data/snakemake
snakemake: $(READY) $(SNAKE)/.ready
	rm -rf $(SNAKE)/parts $(SNAKE)/whole
	$(SNAKE)/bin/snakemake --snakefile examples/Snakefile --directory $(SNAKE) --cores 2 --quiet --config \
	  folder=$(CURDIR)/sample_data out=$(CURDIR)/$(SNAKE)/parts parts=2 accelcal=$(abspath $(BIN))/accelcal
	$(BIN)/accelcal study $(CURDIR)/sample_data -d $(SNAKE)/whole -q || test -s $(SNAKE)/whole/study.csv
	for end in csv parquet json; do cmp $(SNAKE)/parts/study.$$end $(SNAKE)/whole/study.$$end || exit 1; done
	ACCELCAL_SNAKEMAKE=$(CURDIR)/$(SNAKE)/bin/snakemake $(BIN)/python -m pytest -n 0 tests/test_examples.py
	@echo "The same: $(SNAKE)/parts and $(SNAKE)/whole"

$(SNAKE)/.ready:
	$(PYTHON) -m venv $(SNAKE)
	$(SNAKE)/bin/python -m pip install --quiet snakemake
	touch $@

sample-data: $(READY)
	$(BIN)/python tools/make_sample_data.py
	$(BIN)/python tools/make_six_faces.py

figure: $(READY)
	$(BIN)/python tools/make_figure.py
	$(BIN)/python tools/make_drawings.py

# docs/recording_page.png and docs/study_page.png, in a real Chromium
screenshots: browser-ready
	ACCELCAL_CHROMIUM="$$(cat $(BROWSER)/chromium)" $(BIN)/python tools/make_screenshots.py

clean:
	rm -rf $(VENV) $(DEMO) .pytest_cache .mypy_cache .ruff_cache

# after a run of the tests with newer versions (make LOCK= test)
.PHONY: lock
lock: $(READY)
	$(BIN)/python tools/lock.py > requirements.lock

.PHONY: golden
golden: $(READY)
	$(BIN)/python -m tests.golden

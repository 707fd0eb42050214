# make demo: the main job on data in the repo.  make test: every test.  Both set up what they need in .venv.
VENV := .venv
BIN := $(VENV)/bin
PYTHON ?= python3
OUT := demo
PEERS := build/peers
FOLDERS := models plants emulator compiler rtl mismatch control identify machines hardware pages export recordings
unexport PYTHONDONTWRITEBYTECODE # where it is set, each of hundreds of child processes compiles every source anew
NO_FLOATS := rtl random_hardware adders_hardware synthesis proofs engine board c99 browser fuzz fuzzing faults attacks \
    names escapes waveform testing ci schemas invocations imports files serial pipelined targets export

.PHONY: demo docs pages test nightly test-old test-elsewhere lint types fuzz train clean tools peers

demo: $(VENV)/.ready | tools
	$(BIN)/greygate make recordings/cart/cart.toml recordings/cart/train.csv recordings/cart/test.csv --out $(OUT)/cart
	@echo "open $(OUT)/cart/index.html; the Verilog is in $(OUT)/cart/compile/build/rtl"

test: $(VENV)/.ready-dev | tools
	$(BIN)/pytest -n 2 --dist loadfile -m "not nightly"

# What is slow and seldom alone in finding something: fuzz, browsers, random hardware and rigs, every fault of writing, the
# commands of all pages; then what holds floats once more on an old processor.
nightly: $(VENV)/.ready-nightly docs | tools
	GREYGATE_FUZZ=10000 GREYGATE_FAULTS=all $(BIN)/pytest -n 2 -m nightly
	$(BIN)/python -m benchmarks made
	$(MAKE) --no-print-directory test-old test-elsewhere

# The same on the processor of another age: its BLAS and its numpy compute other last bits. Left out is what has no floats:
# Verilog, C and what is made of it, browsers, wrong uses, files that break and strangers that break in.
test-old: $(VENV)/.ready-dev | tools
	$(BIN)/python -m benchmarks processors --setting "old BLAS and numpy" --run \
	  "$(BIN)/pytest -n 2 $(patsubst %,--ignore=tests/test_%.py,$(NO_FLOATS))"

# The same on a system that lacks what Windows lacks, as far as Linux can (tests/elsewhere). pytest asks it for no user's
# name where it is given a folder.
test-elsewhere: $(VENV)/.ready-dev | tools
	LOKY_MAX_CPU_COUNT=2 PYTHONPATH=tests/elsewhere $(BIN)/pytest -n 2 --dist loadfile -m "not nightly" \
	  --basetemp=build/elsewhere

# The pages as a site, build/site/index.html. A link that leads nowhere stops it.
docs: $(VENV)/.ready-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# The figures of the pages, from benchmarks/results and models/trained.
pages: $(VENV)/.ready-dev
	$(BIN)/python docs/pages.py

lint: $(VENV)/.ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(MAKE) --no-print-directory types

# The folders of the package lie side by side here; a type checker is to find them where an import does.
types: $(VENV)/.ready-dev
	rm -rf build/typed && mkdir -p build/typed/greygate
	ln -s $(CURDIR)/greygate/* $(addprefix $(CURDIR)/,$(FOLDERS)) build/typed/greygate
	$(BIN)/mypy

# Nightly: 10,000 mutants of the files that each parser reads.
fuzz: $(VENV)/.ready-dev
	GREYGATE_FUZZ=10000 $(BIN)/pytest tests/test_fuzz.py -s
	$(BIN)/python -m benchmarks made

train: $(VENV)/.ready
	$(BIN)/python -m benchmarks library
	for name in valve_cylinder valve_cylinder_warm asymmetric_cylinder pump_cylinder cable_drum belt_drive mts crane tanks b2; do $(BIN)/greygate train $$name --out models/trained || exit 1; done
	$(BIN)/python -m benchmarks pruned
	$(BIN)/python -m benchmarks made

clean:
	rm -rf $(OUT) build *.egg-info

INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt

$(VENV)/.ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed: make PYTHON=python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) -e .
	@touch $@

$(VENV)/.ready-dev: $(VENV)/.ready
	$(INSTALL) -e '.[dev,synthesis,proof,board,cluster,control,torch,fmi,fusesoc,onnx,matlab,parquet,mdf,tdms,mcap,pandas,app]'
	@touch $@

# What nightly tests alone use: half a gigabyte.
$(VENV)/.ready-nightly: $(VENV)/.ready-dev
	$(INSTALL) -e '.[nightly,browser]'
	@touch $@

$(VENV)/.ready-docs: $(VENV)/.ready
	$(INSTALL) -e '.[docs]'
	@touch $@

# What some benchmarks compare with, in an environment of its own.
peers: $(PEERS)/.ready

$(PEERS)/.ready: benchmarks/peers.txt
	$(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/pip install --quiet --disable-pip-version-check -r benchmarks/peers.txt
	@touch $@

tools:
	@for tool in g++ make perl; do \
	  command -v $$tool >/dev/null || { echo "$$tool is missing: Verilator builds simulations with it; install $$tool"; exit 1; }; \
	done

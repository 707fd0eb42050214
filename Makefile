# make demo: the main job on data in the repo.  make test: every test.  Both set up what they need in .venv.
VENV := .venv
BIN := $(VENV)/bin
PYTHON ?= python3
OUT := demo
PEERS := build/peers
FOLDERS := models plants emulator compiler rtl mismatch control identify machines hardware pages export recordings
NO_FLOATS := rtl random_hardware adders_hardware synthesis proofs engine board c99 browser fuzz fuzzing faults attacks \
    names escapes waveform testing ci schemas invocations imports files serial pipelined targets export

.PHONY: demo docs pages test nightly test-old lint types bench bench-training bench-diagnosis bench-rigs bench-programs fuzz faults \
    mutants train clean tools bench-accuracy calibrate bench-adders resources proofs bench-board bench-tables \
    bench-flow bench-growth bench-exploring bench-blind bench-next bench-speed bench-c99 bench-fmus bench-importers bench-wheel bench-browser bench-memory bench-kills

demo: $(VENV)/.ready | tools
	$(BIN)/greygate compile valve_cylinder --prune 1.0 --out $(OUT)/valve_cylinder
	$(BIN)/greygate compile mts --out $(OUT)/mts
	$(BIN)/greygate verify $(OUT)/valve_cylinder
	$(BIN)/greygate verify $(OUT)/mts
	$(BIN)/greygate report $(OUT)/valve_cylinder $(OUT)/mts --out $(OUT)/report.html
	@echo "open $(OUT)/report.html; the Verilog is in $(OUT)/*/rtl"

test: $(VENV)/.ready-dev | tools
	$(BIN)/python -m pytest -n 2 -m "not nightly"

# What is slow and seldom alone in finding something: fuzz, browsers, random hardware and rigs, every fault of writing, the
# commands of all pages; then what holds floats once more on an old processor.
nightly: $(VENV)/.ready-dev docs | tools
	GREYGATE_FUZZ=10000 GREYGATE_FAULTS=all $(BIN)/python -m pytest -n 2 -m nightly
	$(BIN)/python benchmarks/made.py
	$(MAKE) --no-print-directory test-old

# The same on the processor of another age: its BLAS and its numpy compute other last bits. Left out is what has no floats:
# Verilog, C and what is made of it, browsers, wrong uses, files that break and strangers that break in.
test-old: $(VENV)/.ready-dev | tools
	$(BIN)/python benchmarks/processors.py --setting "old BLAS and numpy" --run \
	  $(BIN)/python -m pytest -n 2 $(patsubst %,--ignore=tests/test_%.py,$(NO_FLOATS))

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

bench: $(VENV)/.ready-dev | tools
	$(BIN)/python benchmarks/engine.py
	$(BIN)/python benchmarks/compile_time.py
	$(BIN)/python benchmarks/plant.py
	$(BIN)/python benchmarks/measured.py
	$(BIN)/python benchmarks/gauss_newton.py
	$(BIN)/python benchmarks/pruning.py

# A quarter of an hour: random programs at the limits of what is legal, beside Python integers.
bench-programs: $(VENV)/.ready-dev | tools
	PYTHONPATH=tests $(BIN)/python benchmarks/random_programs.py

# The C99 target on every scenario of the thesis's machines, by every compiler here.
bench-c99: $(VENV)/.ready-dev
	PYTHONPATH=tests $(BIN)/python benchmarks/c99.py

# Two minutes: FMUs of the thesis's machines in fmpy, every scenario.
bench-fmus: $(VENV)/.ready-dev
	PYTHONPATH=tests $(BIN)/python benchmarks/fmus.py

# Networks of PyTorch, ONNX and MATLAB in their own tools, here, and in Verilog: three minutes; half an hour: the options
# of all that PyTorch has.
bench-importers: $(VENV)/.ready-dev | tools
	PYTHONPATH=tests $(BIN)/python benchmarks/importers.py
	PYTHONPATH=tests $(BIN)/python benchmarks/torch_options.py

# Ten minutes: the wheel in an empty environment and folder, every command of the README.
bench-wheel: $(VENV)/.ready-dev | tools
	$(BIN)/python benchmarks/wheel.py

# Five minutes: every kind of page and the site of the documentation in Chromium, which must be installed.
bench-browser: $(VENV)/.ready-dev docs | tools
	PYTHONPATH=tests $(BIN)/python benchmarks/browser.py

# Twenty minutes: the most memory of look, train, validate, emulate and identify on five million rows.
bench-memory: $(VENV)/.ready-dev
	$(BIN)/python benchmarks/memory.py

# Ten minutes: what a lookup takes on each family, for every form of table.
bench-tables: $(VENV)/.ready-dev
	$(BIN)/python benchmarks/tables.py

# Nightly: 10,000 mutants of the files that each parser reads; every fault at every point; changes to the code that no
# test may overlook.
fuzz: $(VENV)/.ready-dev
	GREYGATE_FUZZ=10000 $(BIN)/python -m pytest tests/test_fuzz.py -s
	$(BIN)/python benchmarks/made.py

faults: $(VENV)/.ready-dev
	GREYGATE_FAULTS=all $(BIN)/python -m pytest tests/test_faults.py -s

mutants: $(VENV)/.ready-dev | tools
	$(BIN)/python benchmarks/mutants.py --jobs 2 --count 120 --out build/mutants.jsonl --report benchmarks/results/mutants.json

# An hour: concealed effects by the hundred, and the measured rigs.
bench-diagnosis: $(VENV)/.ready-dev
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/concealed.py
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/measured_mismatch.py

# Ten minutes: every command of diagnosis on 200 random valid rigs.
bench-rigs: $(VENV)/.ready-dev
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/generated_rigs.py --rigs 200 --jobs 2

# Three minutes: experiments until an ambiguous diagnosis is resolved, by `greygate next`, random ones, multisines.
bench-next: $(VENV)/.ready-dev
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/next_experiments.py

# Half an hour: how long a diagnosis takes; BEFORE=OTHER/.venv/bin has `greygate` of another checkout beside it.
bench-speed: $(VENV)/.ready-dev
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/diagnosis_speed.py $(if $(BEFORE),--before $(BEFORE))

# Hours: the blind benchmark's development split, ours and the baselines. TOOLS=greygate for ours alone.
bench-blind: $(VENV)/.ready-dev
	$(INSTALL) -e '.[bench]'
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/blind.py $(TOOLS)

# Adder graphs beside alkaid's, on the matrices of a file: make bench-adders MATRICES=cmvm.json PEER=python-with-alkaid
bench-adders: $(VENV)/.ready-dev
	$(BIN)/python benchmarks/adders.py $(MATRICES) $(if $(PEER),--peers $(PEER))

# Ten minutes: whole scenarios through the port of a board, in Verilator behind a pseudo terminal; a bitstream.
bench-board: $(VENV)/.ready-dev | tools
	$(BIN)/python benchmarks/board.py --bitstream icebreaker

# An hour: beside other trainers, beside the thesis's minutes, and ten seeds of its benchmark systems.
bench-training: $(VENV)/.ready-dev $(PEERS)/.ready
	$(BIN)/python benchmarks/training.py --peers $(PEERS)/bin/python
	$(BIN)/python benchmarks/training_times.py
	$(BIN)/python benchmarks/growth_training.py --peers $(PEERS)/bin/python
	$(BIN)/python benchmarks/systems.py

# Five minutes: RMS of the flow network at 8 to 20 bits, beside da4ml and alkaid.
bench-accuracy: $(VENV)/.ready-dev $(PEERS)/.ready
	$(BIN)/python benchmarks/accuracy_per_bit.py --peers $(PEERS)/bin/python

# The flow network as parallel designs of two accuracies, by Yosys.
bench-flow: $(VENV)/.ready-dev $(PEERS)/.ready
	$(BIN)/python benchmarks/flow_designs.py --peers $(PEERS)/bin/python

# Compiling, synthesizing and emulating 10 to 10,000 weights, and writing 100,000.
bench-growth: $(VENV)/.ready-dev | tools
	$(BIN)/python benchmarks/growth.py

# Ten minutes: fronts of designs on two FPGAs, and the chosen ones placed, routed and verified.
bench-exploring: $(VENV)/.ready-dev | tools
	$(BIN)/python benchmarks/exploring.py

# Half an hour: what the parts of a design take on each family, by Yosys and nextpnr; writes compiler/explore/cost.toml.
calibrate: $(VENV)/.ready-dev | tools
	$(BIN)/python benchmarks/calibrate.py

train: $(VENV)/.ready
	$(BIN)/python -m greygate.models.families.library
	for name in valve_cylinder valve_cylinder_warm asymmetric_cylinder pump_cylinder cable_drum belt_drive mts crane tanks b2; do $(BIN)/greygate train $$name --out models/trained || exit 1; done
	$(BIN)/python -m greygate.machines.pruned
	$(BIN)/python benchmarks/made.py

# What the thesis's plants take on FPGAs, hours where a tool runs into its limit; and the proofs of a whole network.
resources: $(VENV)/.ready-dev
	$(BIN)/python benchmarks/resources.py --limit 300

proofs: $(VENV)/.ready-dev | tools
	$(BIN)/python benchmarks/proofs.py --limit 300

clean:
	rm -rf $(OUT) build *.egg-info

INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt

$(VENV)/.ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed: make PYTHON=python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) -e .
	@touch $@

$(VENV)/.ready-dev: $(VENV)/.ready
	$(INSTALL) -e '.[dev,synthesis,proof,board,cluster,control,torch,browser,fmi,fusesoc,onnx,matlab,parquet,mdf,tdms,mcap,pandas]'
	@touch $@

$(VENV)/.ready-docs: $(VENV)/.ready
	$(INSTALL) -e '.[docs]'
	@touch $@

$(PEERS)/.ready: benchmarks/peers.txt
	$(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/pip install --quiet --disable-pip-version-check -r benchmarks/peers.txt
	@touch $@

tools:
	@for tool in g++ make perl; do \
	  command -v $$tool >/dev/null || { echo "$$tool is missing: Verilator builds simulations with it; install $$tool"; exit 1; }; \
	done

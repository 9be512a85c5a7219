# Each target makes .venv when it is missing; nothing else has to be done first.

# Not the newest Python: JAX 0.12 on Python 3.13 takes 1.4 times the processor time of JAX 0.10 on 3.11 for a first
# search, and no less for later and longer ones (experiments/search/README.md).
PYTHON ?= python3
# The versions that are installed: those of this Python where a file has them, else those of 3.11.
CONSTRAINTS := $(firstword $(wildcard constraints-$(shell \
  $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null).txt) constraints.txt)
# Windows has its programs in a folder of another name.
BIN := .venv/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
# The environment holds what runs the program, and after that what the tests and all else here need.
PROGRAM := .venv/.program
READY := .venv/.ready
DEMO := demo-maps
SITE := site
BUILT := explorer/node_modules/.built
# The extras that the tests need, and the Pythons of make newest and make lowest.
TESTED := dev,docs,experiments,training
NEWEST ?= $(shell for minor in 15 14 13 12; do python3.$$minor -c '' 2>/dev/null && echo python3.$$minor && break; done)
OLDEST ?= python3.11

.PHONY: demo test test-types test-slow notebooks explorer marimo duckietown gym-duckietown duckietown-sdk onnx interop cluster mujoco readers metadrive pufferdrive rl sb3 shards pcg ued ued-jaxued ued-tests trainers vector-speed simulators sumo newest lowest everything towns yolo lint docs dist certify perception photographs-lab realism gridlock clean study pack

demo: $(PROGRAM)
	rm -rf $(DEMO)
	$(BIN)/elitelanes generate --style town --size 9 9 --evaluations 50000 --maps 16 --out $(DEMO)/towns
	$(BIN)/elitelanes generate --style paper --size 12 12 --seeds 16 --maps 16 --out $(DEMO)/paper

test: $(READY)
	$(BIN)/python -m pytest -n auto --dist loadfile --durations 20

# Without the tests that call programs of others: each of those has a target below.
PROGRAMS := $(patsubst %,tests/%.py,dataset/test_training experiments/test_transfer formats/test_duckietown \
  formats/test_duckiematrix formats/test_metadrive formats/test_pufferdrive maps/test_gym_duckietown)

test-slow: $(READY)
	$(BIN)/python -m pytest -n auto --dist loadfile -m slow $(addprefix --ignore=,$(PROGRAMS)) \
	  --deselect tests/formats/test_commonroad.py::test_commonroad_reads_and_plans

# The types in signatures, with the shapes and dtypes of arrays, are checked at every call.
test-types: $(READY)
	$(BIN)/python -m pytest -p typecheck -n auto --dist loadfile tests/network tests/problem tests/optimizers tests/drive

# All notebooks with few steps, side by side. Other than -m slow, this expression compiles quickly, as make test does.
# NOTEBOOKS selects some, such as NOTEBOOKS='quickstart or drive'.
NOTEBOOKS ?= test_runs
notebooks: $(READY)
	$(BIN)/python -m pytest -n auto -m 'slow or not slow' -k 'test_runs and ($(NOTEBOOKS))' tests/docs/test_notebooks.py

# The explorer's module is built anew; it differs from the one in the package only where a change was not built.
# Then the page and the widget are clicked through, in Chromium and JupyterLab. PAGES= leaves that out.
PAGES := $(patsubst %,tests/explorer/test_%.py,explorer_browser explorer_widget explorer_views hands)

explorer: $(READY) .venv/.notebooks explorer/node_modules/.ready
	cd explorer && npm run --silent check && npm run --silent test && node build.mjs ../$(BUILT)
	diff -r $(BUILT) elitelanes_jax/explorer/static
	$(if $(PAGES),$(BIN)/python -m pytest -n 2 --dist loadfile $(PAGES))

.venv/.notebooks: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c $(CONSTRAINTS) -e '.[notebooks]'
	touch $@

explorer/node_modules/.ready: explorer/package.json explorer/package-lock.json
	cd explorer && npm ci --silent
	touch $@

# Tests that need large or old packages have an environment each. It is made again when its packages change.
# SUMO.
sumo: .venv-sumo/.ready
	.venv-sumo/bin/python -m pytest -m slow tests/formats/test_sumo.py tests/docs/test_notebooks.py -k sumo

# Twenty readers by others on 1,000 drawn maps, 100 odd ones and those of duckietown-world; it goes on where it ended.
# READERS='carla --share 0.1' has some of the readers read a part of the maps.
readers: $(READY) .venv-duckietown/.ready
	$(BIN)/python tests/formats/readers/check.py $(READERS)

# The places of lanes in CARLA, and routes in Lanelet2 and CommonRoad, on a thousand maps and those of duckietown-world.
simulators: .venv-simulators/.ready .venv-commonroad/.ready .venv-duckietown/.ready
	.venv-simulators/bin/python -m pytest -n auto -m slow tests/formats/test_opendrive.py \
	  tests/formats/test_lanelet2.py tests/formats/test_commonroad.py

# marimo.
marimo: .venv-marimo/.ready explorer/node_modules/.ready
	.venv-marimo/bin/python -m pytest -m slow tests/explorer/test_explorer_widget.py

# QDax, evosax and pyribs.
interop: .venv-interop/.ready
	.venv-interop/bin/python -m pytest -m 'slow or not slow' -k 'interop or pyribs' \
	  tests/optimizers/test_interop.py tests/docs/test_notebooks.py

# Dask with two worker processes, one of which is killed; Submitit without SLURM; spawned processes.
cluster: .venv-cluster/.ready
	.venv-cluster/bin/python -m pytest -m 'slow or not slow' tests/test_executors.py tests/docs/test_scaling_page.py

# Gymnasium's check of environments and its vector environments, and the loops of Gymnax and Rejax.
rl: .venv-rl/.ready
	.venv-rl/bin/python -m pytest -m 'slow or not slow' tests/drive/test_wrappers.py tests/drive/test_vectors.py

# Stable-Baselines3, which needs PyTorch, and the core of PufferLib. PufferLib itself does not install without CUDA.
sb3: .venv-sb3/.ready
	.venv-sb3/bin/python -m pytest -m 'slow or not slow' tests/drive/test_vectors.py

# The methods of environment design, on the level sampler of JaxUED.
ued-tests: .venv-ued/.ready
	.venv-ued/bin/python -m pytest -m 'slow or not slow' tests/experiments/test_ued.py

# Packs of maps for other programs, in results/packs; PACK='town city' makes some of them. Each goes on where
# it ended. Hard ones have few loops and straights, where drivers fail slightly more often (experiments/navigation).
PACK-town := --style town --size 9 9 --evaluations 50000
PACK-paper := --style paper --size 12 12 --evaluations 50000
PACK-city := --style town --size 24 24 --evaluations 20000
PACK-hard := --size 12 12 --where cyclomatic=1..14 straight_share=..0.6 --evaluations 100000
PACKED := opendrive duckietown mujoco movingai

PACK := town paper city hard

pack: $(addprefix results/packs/,$(PACK))

results/packs/%: $(PROGRAM)
	test -d results/pack-maps/$* || $(BIN)/elitelanes generate $(PACK-$*) --maps 100 --seeds 8 --tile-px 16 \
	  --out results/pack-maps/$*
	test -d $@ || $(BIN)/elitelanes pack results/pack-maps/$* --to $(PACKED) --tile-px 32 --out $@

# MuJoCo, trimesh and OpenUSD; MuJoCo draws by EGL, without a display (Debian's libegl1).
mujoco: .venv-mujoco/.ready
	.venv-mujoco/bin/python -m pytest -m slow tests/formats/test_floor.py tests/formats/test_usd.py

# MetaDrive, called from ours as a program. It draws nothing, so it does not download its pictures from GitHub.
metadrive: $(READY) .venv-metadrive/.ready
	$(BIN)/python -m pytest -m slow tests/formats/test_metadrive.py

.venv-metadrive/.ready:
	rm -rf .venv-metadrive
	$(PYTHON) -m venv .venv-metadrive
	.venv-metadrive/bin/python -m pip install --quiet --disable-pip-version-check metadrive-simulator==0.4.3 \
	  eclipse-sumo sumolib
	touch $@

# PufferDrive's core in C, without its window: of a fork, because later versions do not join lanes by themselves.
# PUFFERDRIVE= names a checkout of that commit; without it, git clones one.
PUFFERDRIVE ?= .venv-pufferdrive/source
PUFFERDRIVE_FORK := https://github.com/CILAB-MA/PufferDrive
PUFFERDRIVE_COMMIT := 0439aa59ed73188036f7ca46b03a3d657caacc45
DRIVE := $(PUFFERDRIVE)/pufferlib/ocean/drive

pufferdrive: $(READY) .venv-pufferdrive/pufferdrive_check
	$(BIN)/python -m pytest -m slow tests/formats/test_pufferdrive.py

.venv-pufferdrive/pufferdrive_check: tests/formats/pufferdrive_check.c
	mkdir -p .venv-pufferdrive
	test -d $(PUFFERDRIVE) || git clone --quiet $(PUFFERDRIVE_FORK) $(PUFFERDRIVE)
	test "$(PUFFERDRIVE)" != .venv-pufferdrive/source || git -C $(PUFFERDRIVE) checkout --quiet $(PUFFERDRIVE_COMMIT)
	sed -e '/"raylib.h"/d' -e '/"raymath.h"/d' -e '/"rlgl.h"/d' -e '/^const Color STONE_GRAY/,$$d' $(DRIVE)/drive.h \
	  > .venv-pufferdrive/drive_core.h
	gcc -O2 -w -D_GNU_SOURCE -include stdbool.h -I.venv-pufferdrive -I$(DRIVE) -o $@ $< -lm

# webdataset, Hugging Face's datasets on Parquet, and mlcroissant on all layouts.
shards: .venv-shards/.ready
	.venv-shards/bin/python -m pytest tests/dataset/test_shards.py tests/dataset/test_croissant.py

# Ultralytics and PyTorch, called from ours as programs.
yolo: $(READY) .venv-yolo/.ready
	$(BIN)/python -m pytest -m slow tests/dataset/test_training.py

# Ultralytics asks for packages that only its commands need, and for an OpenCV with windows.
.venv-yolo/.ready:
	rm -rf .venv-yolo
	$(PYTHON) -m venv .venv-yolo
	.venv-yolo/bin/python -m pip install --quiet --disable-pip-version-check torch==2.13.0 opencv-python-headless \
	  matplotlib pillow polars psutil pyyaml requests
	.venv-yolo/bin/python -m pip install --quiet --disable-pip-version-check --no-deps torchvision==0.28.0 \
	  ultralytics==8.4.190
	touch $@

EXTRAS-mujoco := dev,mujoco
EXTRAS-shards := dev,shards
EXTRAS-sumo := dev,plots,sumo
EXTRAS-simulators := dev,sumo
EXTRAS-marimo := dev,marimo
EXTRAS-interop := dev,interop,plots
EXTRAS-rl := dev,rl
EXTRAS-onnx := dev,training,onnx
EXTRAS-cluster := dev,cluster,dask
EXTRAS-sb3 := dev,sb3
EXTRAS-ued := dev,experiments,ued
# JaxUED's scripts import it.
MORE-ued := distrax==0.1.9
# CleanRL's PPO imports these two.
MORE-sb3 := tensorboard==2.21.0 tyro==1.0.17
BARE-sb3 := pufferlib-core==3.0.23
MORE-mujoco := usd-core==26.11 mujoco-mjx
MORE-simulators := carla==0.9.16 lanelet2==1.2.3

$(patsubst %,.venv-%/.ready,mujoco onnx shards sumo simulators marimo interop cluster rl sb3 ued): .venv-%/.ready: pyproject.toml $(CONSTRAINTS)
	rm -rf .venv-$*
	$(PYTHON) -m venv .venv-$*
	.venv-$*/bin/python -m pip install --quiet --disable-pip-version-check -c $(CONSTRAINTS) -e '.[$(EXTRAS-$*)]' \
	  $(MORE-$*)
	$(if $(BARE-$*),.venv-$*/bin/python -m pip install --quiet --disable-pip-version-check --no-deps $(BARE-$*))
	touch $@

# The newest Python on the PATH, with the newest versions that pip finds today.
newest:
	@test -n "$(NEWEST)" || { echo "elitelanes_jax: expected a Python after 3.11 on the PATH, such as python3.13, or as" \
	  "NEWEST=, got none"; exit 2; }
	rm -rf .venv-newest
	$(NEWEST) -m venv .venv-newest
	.venv-newest/bin/python -m pip install --quiet --disable-pip-version-check -e '.[$(TESTED)]'
	.venv-newest/bin/python -m pytest -n auto --dist loadfile

# Python 3.11 with the lowest versions that pyproject.toml allows. Warnings of old packages are no errors.
lowest: .venv-lowest/.ready
	.venv-lowest/bin/python -m pytest -n auto --dist loadfile -W default

.venv-lowest/.ready: pyproject.toml
	@$(OLDEST) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' \
	  || { echo "elitelanes_jax: expected Python 3.11 as OLDEST=$(OLDEST), got $$($(OLDEST) --version 2>&1)"; exit 2; }
	rm -rf .venv-lowest
	$(OLDEST) -m venv .venv-lowest
	.venv-lowest/bin/python -m pip install --quiet --disable-pip-version-check uv
	.venv-lowest/bin/uv pip install --quiet --python .venv-lowest --resolution lowest-direct -e '.[$(TESTED)]'
	touch $@

# The tests in all environments, with a row for each in docs/tested.md. ENVIRONMENTS selects some.
everything: $(READY)
	$(BIN)/python tests/everything.py $(ENVIRONMENTS)

# duckietown-world, called from ours as a program.
duckietown: $(READY) .venv-duckietown/.ready
	$(BIN)/python -m pytest -m slow tests/formats/test_duckietown.py

# gym-duckietown and dt-maps, without a display: Debian's libegl1 and libglu1-mesa.
gym-duckietown: $(READY) .venv-gym-duckietown/.ready
	$(BIN)/python -m pytest -m slow tests/maps/test_gym_duckietown.py tests/experiments/test_transfer.py

# The reader of the Duckiematrix' maps in Duckietown's SDK, called from ours as a program.
duckietown-sdk: $(READY) .venv-duckietown-sdk/.ready
	$(BIN)/python -m pytest -m slow tests/formats/test_duckiematrix.py

# A thousand towns, loaded by duckietown-world and driven through in SUMO; it goes on where it ended.
towns: $(READY) .venv-duckietown/.ready .venv-sumo/.ready
	test -d results/towns || $(BIN)/elitelanes generate --style town --size 9 9 --maps 1000 --seeds 32 \
	  --evaluations 100000 --out results/towns
	.venv-sumo/bin/python tests/formats/check_folder.py sumo results/towns
	$(BIN)/python tests/formats/check_folder.py duckietown results/towns

.venv-duckietown/.ready: tests/formats/duckietown_world/requirements.txt
.venv-duckietown-sdk/.ready: tests/formats/duckietown_sdk/requirements.txt
.venv-duckietown/.ready .venv-duckietown-sdk/.ready: .venv-%/.ready:
	rm -rf .venv-$*
	$(PYTHON) -m venv .venv-$*
	.venv-$*/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -r $<
	touch $@

.venv-gym-duckietown/.ready: tests/maps/gym_duckietown/requirements.txt
	rm -rf .venv-gym-duckietown
	$(PYTHON) -m venv .venv-gym-duckietown
	.venv-gym-duckietown/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	touch $@

# Programs that tests call, with packages that do not fit ours: NumPy below 2, and an old protobuf.
.venv-commonroad/.ready: .venv-%/.ready: tests/formats/requirements-%.txt
	rm -rf .venv-$*
	$(PYTHON) -m venv .venv-$*
	.venv-$*/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	touch $@

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --site-dir $(SITE)

# The source distribution and the wheel for the package index. The wheel, installed alone, makes two maps.
dist: .venv-build/.ready
	rm -rf dist .venv-wheel
	.venv-build/bin/python -m build
	.venv-build/bin/twine check --strict dist/*
	$(PYTHON) -m venv .venv-wheel
	.venv-wheel/bin/python -m pip install --quiet --disable-pip-version-check -c $(CONSTRAINTS) dist/*.whl
	cd .venv-wheel && bin/elitelanes --version \
	  && bin/elitelanes generate --size 5 5 --maps 2 --seeds 2 --evaluations 500 --out maps

.venv-build/.ready:
	rm -rf .venv-build
	$(PYTHON) -m venv .venv-build
	.venv-build/bin/python -m pip install --quiet --disable-pip-version-check build twine
	touch $@

# A study of experiments/, such as STUDY=perception.cutting: docs/make.md has their names.
study: $(READY)
	$(BIN)/python -m experiments.$(or $(STUDY),$(error expected STUDY=NAME, such as STUDY=perception.cutting))

certify: $(READY)
	$(BIN)/python -m experiments.search.certify --out results/certificates.json --table results/certificates.md

# The commands of docs/perception.md.
SEE := $(BIN)/python -m experiments.perception.gym_duckietown
SEEN := results/perception

perception: $(READY) .venv-gym-duckietown/.ready
	test -d $(SEEN)/views || $(BIN)/elitelanes dataset --out $(SEEN)/views --style town --where crossings=0.. --maps 60 --views 500 \
	  --size 7 --evaluations 2000 --split 1 0 0 --tile-px 96 --camera rows=120 columns=160 lines=0.07 \
	  --transform varied blur=0.5
	test -f $(SEEN)/pose.npz || $(SEE).train pose $(SEEN)/views --out $(SEEN)/pose.npz
	test -f $(SEEN)/labels.npz || $(SEE).train labels $(SEEN)/views --out $(SEEN)/labels.npz
	$(SEE).pictures test --only people --poses 12 --out $(SEEN)/photos.npz
	$(SEE).evaluate $(SEEN)/photos.npz --pose $(SEEN)/pose.npz --labels $(SEEN)/labels.npz --out $(SEEN)/tables.md
	$(SEE).rides $(SEEN)/pose.npz --only people --out $(SEEN)/pose-rides.json

# Networks as ONNX files, compared with JAX in the pictures of make perception, and rides by the file alone.
SEE_ONNX := .venv-onnx/bin/python -m experiments.perception.gym_duckietown

onnx: .venv-onnx/.ready .venv-gym-duckietown/.ready
	.venv-onnx/bin/python -m pytest tests/experiments/test_onnx.py
	test -f $(SEEN)/photos.npz || $(SEE_ONNX).pictures test --only people --poses 12 --out $(SEEN)/photos.npz
	for task in pose labels; do \
	  $(SEE_ONNX).export_onnx $$task --out $(SEEN)/$$task.onnx --pictures $(SEEN)/photos.npz || exit; \
	  $(SEE_ONNX).export_onnx $$task --out $(SEEN)/$$task-int8.onnx --int8 --pictures $(SEEN)/photos.npz || exit; \
	done
	$(SEE_ONNX).rides $(SEEN)/pose.onnx --only people --out $(SEEN)/onnx-rides.json
	$(SEE_ONNX).rides $(SEEN)/pose-int8.onnx --only people --out $(SEEN)/onnx-int8-rides.json

# A network that learns from photographs of gym-duckietown's tiles. LAB adds options, such as LAB='--seeds 3'.
photographs-lab: $(READY) .venv-gym-duckietown/.ready
	$(SEE).lab $(LAB)

realism: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c $(CONSTRAINTS) -e '.[realism]'
	$(BIN)/python -m experiments.realism.study

# Cars in SUMO on 200 towns; it goes on where it ended.
gridlock: .venv-sumo/.ready
	.venv-sumo/bin/python -m experiments.gridlock.study

vector-speed: .venv-rl/.ready
	.venv-rl/bin/python -m experiments.navigation.vector_speed

UED := study

ued: .venv-ued/.ready
	.venv-ued/bin/python -m experiments.navigation.ued.$(UED)

# JaxUED's own methods, of a commit that git clones, or of the checkout that JAXUED= names.
JAXUED ?= .venv-ued/jaxued
JAXUED_COMMIT := 0f8f1284677375b889e4f13a32c9617cd009f8c4

ued-jaxued: .venv-ued/.ready
	test -d $(JAXUED) || git clone --quiet https://github.com/DramaCow/jaxued $(JAXUED)
	test "$(JAXUED)" != .venv-ued/jaxued || git -C $(JAXUED) checkout --quiet $(JAXUED_COMMIT)
	.venv-ued/bin/python -m experiments.navigation.ued.jaxued_methods --jaxued $(JAXUED)

# The PCG Benchmark and its generators, of commits that git clones, or of the checkouts that PCG= and
# PCG_GENERATORS= name.
PCG ?= .venv/pcg
PCG_GENERATORS ?= .venv/pcg_generators
PCG_COMMIT := 00b96f57a3eba3529b1293de1e70d5b12a1f60cc
PCG_GENERATORS_COMMIT := 2c7ce70274c1a6c44386e9d3dc8e0d4b8dd27486

pcg: $(READY)
	test -d $(PCG) || git clone --quiet https://github.com/amidos2006/pcg_benchmark $(PCG)
	test "$(PCG)" != .venv/pcg || git -C $(PCG) checkout --quiet $(PCG_COMMIT)
	test -d $(PCG_GENERATORS) || git clone --quiet https://github.com/amidos2006/benchmark_experiments $(PCG_GENERATORS)
	test "$(PCG_GENERATORS)" != .venv/pcg_generators || git -C $(PCG_GENERATORS) checkout --quiet $(PCG_GENERATORS_COMMIT)
	PYTHONPATH=$(PCG):$(PCG_GENERATORS) $(BIN)/python -m pytest tests/benchmark/test_pcg.py
	PYTHONPATH=$(PCG):$(PCG_GENERATORS) $(BIN)/python -m experiments.search.pcg

trainers: .venv-sb3/.ready results/trainer-towns
	.venv-sb3/bin/python -m experiments.navigation.trainers results/trainer-towns

results/trainer-towns: $(PROGRAM)
	$(BIN)/elitelanes generate --style town --where crossings=0.. --size 7 7 --evaluations 20000 --maps 200 --tile-px 16 --out $@

clean:
	rm -rf dist explorer/node_modules .venv .venv-* $(DEMO) $(SITE)

$(PROGRAM): pyproject.toml $(CONSTRAINTS)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "elitelanes_jax: expected Python 3.11 or later as $(PYTHON), got $$($(PYTHON) --version 2>&1)"; exit 2; }
	$(PYTHON) -m venv .venv
	@echo "installing what runs the program, most of it JAX"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c $(CONSTRAINTS) -e .
	touch $@

# Python compiles a module when it is first imported. pip would compile all of them, which takes 20 s.
$(READY): $(PROGRAM)
	@echo "installing what the tests need"
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c $(CONSTRAINTS) \
	  -e '.[$(TESTED)]'
	touch $@

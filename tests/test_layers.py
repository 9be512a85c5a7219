"""The house: imports go one way, and kernels bring no pictures with them."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import elitelanes_jax

PACKAGE = Path(elitelanes_jax.__file__).parent

# From the ground up. A module imports modules of lower lines only.
FLOORS = """
version  errors  exports
checks  codes  draws  extras  folders  illumination  interrupts  overview  progress  compile_cache  tile_files
command  transforms  versions  exports.graph  exports.boxes
lattice  grids  tilesets  wfc  fixed_point  templates  exports.duckietown
faces  repairs  symmetry  roadmap  masking  exports.sumo
metrics  render
exports.table  objective  features  dataset.formats  dataset.work  seams
archive  requests  rules  dataset.card  dataset.samples  exports.command
problem  variation
evolution  moves
annealing  interop
optimizers.base
optimizers.ea  optimizers.map_elites  optimizers.pso  optimizers.gwo  optimizers.annealed  optimizers.aimed_map_elites
optimizers
run
search
selection  plots
wishes
generate  dataset.settings
dataset.plan
dataset.make
dataset
dataset_command  tiles_command
cli
"""
FLOOR = {name: floor for floor, line in enumerate(FLOORS.split("\n")) for name in line.split()}

# What the search side must not know: pictures; and the picture side: searches.
PICTURES = {
    *("tile_files", "tilesets", "masking", "seams", "render", "overview", "transforms"),
    *("dataset.card", "dataset.samples"),
}

# All that imports OpenCV.
OPENCV = PICTURES - {"tilesets", "dataset.samples"} | {"versions", "dataset.make"}


def modules():
    for file in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(file.relative_to(PACKAGE).with_suffix("").parts)
        yield name.removesuffix(".__init__"), file


def imported(file):
    """Modules of ours, and top names of others, that a file imports anywhere."""
    ours, others = set(), set()
    for node in ast.walk(ast.parse(file.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            names = [node.module]
        for name in names:
            if name.startswith("elitelanes_jax."):
                ours.add(name.removeprefix("elitelanes_jax."))
            else:
                others.add(name.split(".")[0])
    return ours, others


def test_imports_go_one_way():
    found = dict(modules())
    assert set(FLOOR) == set(found) - {"__init__"}
    for name, file in found.items():
        ours, _ = imported(file)
        if name != "__init__":
            higher = [other for other in ours if FLOOR[other] >= FLOOR[name]]
            assert not higher, f"{name} imports {higher}"


def reach(name, found):
    """All modules that one needs, directly or not."""
    needed, waiting = set(), [name]
    while waiting:
        for other in imported(found[waiting.pop()])[0] - needed:
            needed.add(other)
            waiting.append(other)
    return needed


def test_search_and_pictures_meet_at_a_grid_only():
    found = dict(modules())
    for name, file in found.items():
        _, others = imported(file)
        assert ("cv2" in others) == (name in OPENCV), name
    for name in PICTURES:
        assert not {"metrics", "problem", "search", "optimizers"} & reach(name, found)
    for name in ("search", "selection", "run"):
        assert not PICTURES & reach(name, found)


def test_other_libraries_are_met_at_a_function_only():
    for name, file in modules():
        _, others = imported(file)
        assert not {"qdax", "evosax", "ribs"} & others, name
        assert ("matplotlib" in others) == (name == "plots"), name


def test_optimizers_know_neither_each_other_nor_the_fitness():
    found = dict(modules())
    names = {name for name in found if name.startswith("optimizers.")} - {"optimizers.base"}
    for name in names:
        ours, _ = imported(found[name])
        assert not ours & (names | {"objective"})


def test_one_scan_runs_all_optimizers():
    scans = [name for name, file in modules() if "scan(" in file.read_text()]
    assert scans == ["run"]


def test_every_module_says_what_is_public_and_what_it_is():
    for name, file in modules():
        tree = ast.parse(file.read_text())
        assert ast.get_docstring(tree), name
        module = __import__(f"elitelanes_jax.{name}".removesuffix(".__init__"), fromlist=["__all__"])
        assert sorted(set(module.__all__)) == sorted(module.__all__)
        defined = {
            node.name
            for node in tree.body
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
        }
        assert defined <= set(module.__all__), name
        for public in module.__all__:
            assert hasattr(module, public)


def _loaded(program):
    """The modules that a program has loaded when it is done."""
    code = f"{program}; import sys; print(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())


def _jaxs_own():
    return {name.split(".")[0] for name in _loaded("import jax, chex")}


@pytest.mark.parametrize(
    "program",
    ["import elitelanes_jax", "from elitelanes_jax import measure, fitness, repair, random_grids, Weights, Metrics"],
)
def test_kernels_bring_no_pictures_no_plots_and_no_command_line(program):
    loaded = _loaded(program)
    tops = {name.split(".")[0] for name in loaded}
    assert not tops & {"cv2", "matplotlib", "argparse", "click", "typer", "rich", "tqdm", "PIL"} - _jaxs_own()
    assert "elitelanes_jax.cli" not in loaded


@pytest.mark.parametrize(
    "program",
    [
        "import elitelanes_jax",
        "import elitelanes_jax.cli; elitelanes_jax.cli._parser()",
        "import elitelanes_jax.render, elitelanes_jax.symmetry, elitelanes_jax.roadmap, elitelanes_jax.wfc",
        "import elitelanes_jax.plots",
    ],
)
def test_what_needs_no_jax_does_not_wait_for_it(program):
    assert not {name.split(".")[0] for name in _loaded(program)} & {"jax", "jaxlib", "chex"}


def test_the_package_says_what_it_has():
    assert set(elitelanes_jax.__all__) <= set(dir(elitelanes_jax))
    with pytest.raises(AttributeError, match="module 'elitelanes_jax' has no attribute 'nothing'"):
        _ = elitelanes_jax.nothing

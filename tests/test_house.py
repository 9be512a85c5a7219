"""The house: rooms say what is public, and nothing is loaded without need. `make lint` checks imports between them."""

import ast
import subprocess
import sys
from collections import defaultdict
from functools import cache
from importlib import import_module
from pathlib import Path

import grimp
import networkx as nx
import pytest
from pages import READERS, programs

import elitelanes_jax

PACKAGE = Path(elitelanes_jax.__file__).parent
REPOSITORY = PACKAGE.parent
MODULES = {
    ".".join((PACKAGE.name, *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): file
    for file in sorted(PACKAGE.rglob("*.py"))
}
FACES = [name for name, file in MODULES.items() if file.with_suffix(".pyi").exists()]


def imported(tree: ast.AST):
    """The modules of the package that a program imports from, with the names; a whole module is the name ``*``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == PACKAGE.name:
            yield from ((node.module, name.name) for name in node.names)
        elif isinstance(node, ast.Import):
            yield from ((name.name, "*") for name in node.names if name.name.split(".")[0] == PACKAGE.name)


@pytest.mark.parametrize("name", FACES)
def test_a_face_has_what_it_lists(name):
    face = import_module(name)
    assert dir(face) == sorted(face.__all__)
    stub = MODULES[name].with_suffix(".pyi").read_text(encoding="utf-8")
    for public in face.__all__:
        # A module of the name would hide what is public.
        assert f"{name}.{public}" not in MODULES or f"from . import {public} as" in stub
        assert getattr(face, public) is not None
    with pytest.raises(AttributeError, match="nothing"):
        _ = face.nothing


def test_a_name_means_the_same_in_every_face():
    """`network.fitness` was a module, and `elitelanes_jax.fitness` a function."""
    meanings = defaultdict(list)
    for face in map(import_module, FACES):
        for name in face.__all__:
            meanings[name].append(getattr(face, name))
    for name, things in meanings.items():
        if name != "interop":
            assert all(thing is things[0] for thing in things), name


def test_private_modules_are_imported_by_their_own_room_alone():
    for user, file in MODULES.items():
        for module in {module for module, _ in imported(ast.parse(file.read_text(encoding="utf-8")))}:
            room, _, name = module.rpartition(".")
            shared = room == PACKAGE.name  # helpers of all rooms
            assert not name.startswith("_") or shared or user.startswith(room), f"{user} imports {module}"


def test_no_modules_import_each_other_in_a_circle():
    """Imports in functions count. The contracts hold the order of the rooms."""
    imports = grimp.build_graph("elitelanes_jax", exclude_type_checking_imports=True, cache_dir=None)
    graph = nx.DiGraph(
        (module, imported)
        for module in imports.modules
        for imported in imports.find_modules_directly_imported_by(module)
    )
    assert graph.number_of_edges() > 1000
    assert not [circle for circle in nx.strongly_connected_components(graph) if len(circle) > 1]


def test_readers_are_shown_public_names_alone():
    public = {name: set(import_module(name).__all__) for name in FACES}
    whole = {PACKAGE.name} | {f"{face}.{name}" for face, names in public.items() for name in names}
    for file in READERS:
        for program in programs(file):
            for module, name in imported(ast.parse(program)):
                assert name in public.get(module, ()) or module in whole, f"{file}: {name} of {module}"


def loaded(program, before="import sys"):
    """The packages that a program loads beside those that are loaded before it."""
    program = f"{before}; import sys; there = {{*sys.modules}}; {program}; print(); print(*{{*sys.modules}} - there)"
    ran = subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    return {name.split(".")[0] for name in ran.stdout.splitlines()[-1].split()}


def test_kernels_bring_no_pictures_no_plots_and_no_command_line():
    program = "from elitelanes_jax import measure, fitness, repair, random_grids, Weights, Metrics"
    names = loaded(program, before="import jax, chex, jaxtyping")
    assert not names & {"cv2", "matplotlib", "argparse", "PIL", "filelock"}


def test_what_needs_no_jax_does_not_wait_for_it():
    program = (
        "from elitelanes_jax import DatasetSpec, GenerateSpec, RoadMap, SearchSpec, mirror, plots, read_map, render;"
        "from elitelanes_jax.network import plain_measure, wfc;"
        "from elitelanes_jax.cli.main import make_parser; make_parser()"
    )
    assert not loaded(program) & {"jax", "jaxlib", "chex"}


def loaded_by_commands(*lines):
    program = f"from elitelanes_jax.cli.main import main; [main(line.split()) for line in {lines!r}]"
    return loaded(program)


def test_commands_that_search_for_nothing_do_not_wait_for_jax():
    """Neither do searches that are refused; these read the tiles, whose alphabet they draw from."""
    names = loaded_by_commands("show docs/examples/town.json", "metrics bridges")
    assert not names & {"jax", "jaxlib", "cv2", "scipy"}
    names = loaded_by_commands("generate --method luck --out x", "dataset --where cycles=3 --out x")
    assert not names & {"jax", "jaxlib", "scipy"}


def test_no_private_part_of_jax_is_used():
    """The package uses what JAX documents: no private module, and no private attribute of anything that JAX returns."""
    for name, file in MODULES.items():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            modules = []
            if isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            elif isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            for module in modules:
                parts = module.split(".")
                assert parts[0] not in ("jaxlib", "xla"), f"{name} imports {module}"
                assert parts[0] != "jax" or not any(part.startswith("_") for part in parts), f"{name} imports {module}"
            if isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.endswith("__"):
                own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls", "os", "sys", "np")
                of_tuples = ("_asdict", "_fields", "_replace", "_make", "_field_defaults")
                documented = node.attr in of_tuples
                of_package = node.attr in private_names()
                assert own or documented or of_package, f"{name}: {ast.unparse(node)}"


@cache
def private_names():
    """The private names that the package itself defines."""
    return {name for name in defined_names() if name.startswith("_")}


def defined_names():
    for file in MODULES.values():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                yield node.name
            elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                yield node.attr
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                yield node.target.id


def test_shapes_belong_to_classes_of_arrays():
    """From Python 3.13 on jaxtyping refuses `Annotated` types, such as `AnyArray`, when the package is imported."""
    for name, file in MODULES.items():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Tuple):
                array, *shape = map(ast.unparse, node.slice.elts)
                has_shape = len(shape) == 1 and shape[0].startswith(("'", '"'))
                annotated = array in ("AnyArray", "ArrayOrRows", "ArrayT", "Numeric", "Numbers", "Whole")
                assert not (has_shape and annotated), f"{name}: {ast.unparse(node)}"


def test_chex_checks_the_edges():
    users = {name for name, file in MODULES.items() if "import chex" in file.read_text(encoding="utf-8")}
    assert "elitelanes_jax.network.edges" in users

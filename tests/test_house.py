"""The house: imports between rooms go one way, rooms say what is public, and nothing is loaded without need."""

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

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
TREES = {name: ast.parse(file.read_text(encoding="utf-8")) for name, file in MODULES.items()}


def imported(tree: ast.AST):
    """The modules of the package that a program imports from, with the names; a whole module is the name ``*``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == PACKAGE.name:
            yield from ((node.module, name.name) for name in node.names)
        elif isinstance(node, ast.Import):
            yield from ((name.name, "*") for name in node.names if name.name.split(".")[0] == PACKAGE.name)


def test_imports_keep_the_contracts():
    """The contracts between rooms are in pyproject.toml."""
    program = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    command = [sys.executable, "-c", program]
    ran = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout


@pytest.mark.parametrize("name", FACES)
def test_a_face_has_what_it_lists(name):
    face = import_module(name)
    assert dir(face) == sorted(face.__all__)
    for public in face.__all__:
        assert getattr(face, public) is not None
    with pytest.raises(AttributeError, match="nothing"):
        _ = face.nothing


@pytest.mark.parametrize("name", FACES)
def test_no_module_takes_the_name_of_a_public_function(name):
    """An import of the module would put it in the function's place."""
    stub = ast.parse(MODULES[name].with_suffix(".pyi").read_text(encoding="utf-8"))
    taken = {
        alias.name
        for node in ast.walk(stub)
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }
    assert not {f"{name}.{public}" for public in taken} & set(MODULES)


@pytest.mark.parametrize("name", [name for name in MODULES if name.rpartition(".")[2].startswith("_")])
def test_private_modules_are_imported_by_their_own_room_alone(name):
    room = name.rpartition(".")[0]
    if room == PACKAGE.name:
        return  # helpers that all rooms share
    users = [user for user, tree in TREES.items() if any(module == name for module, _ in imported(tree))]
    assert not [user for user in users if not user.startswith(room)]


def test_readers_are_shown_public_names_alone():
    public = {name: set(import_module(name).__all__) for name in FACES}
    whole = {f"{face}.{name}" for face, names in public.items() for name in names}
    for file in READERS:
        for program in programs(file):
            for module, name in imported(ast.parse(program)):
                assert name in public.get(module, ()) or module in whole, f"{file}: {name} of {module}"


def loaded(program):
    """The modules that a program has loaded when it is done."""
    code = f"{program}; import sys; print(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())


def test_kernels_bring_no_pictures_no_plots_and_no_command_line():
    jax_alone = {name.split(".")[0] for name in loaded("import jax, chex, jaxtyping")}
    names = loaded("from elitelanes_jax import measure, fitness, repair, random_grids, Weights, Metrics")
    tops = {name.split(".")[0] for name in names}
    assert not tops & {"cv2", "matplotlib", "argparse", "rich", "tqdm", "PIL", "filelock"} - jax_alone
    assert "elitelanes_jax.cli" not in names


def test_what_needs_no_jax_does_not_wait_for_it():
    program = (
        "from elitelanes_jax import DatasetSpec, GenerateSpec, RoadMap, SearchSpec, mirror, plots, read_map, render;"
        "from elitelanes_jax.network import plain_measure, wfc;"
        "from elitelanes_jax.cli.main import make_parser; make_parser()"
    )
    assert not {name.split(".")[0] for name in loaded(program)} & {"jax", "jaxlib", "chex"}


@pytest.mark.parametrize(
    "command",
    [
        ["show", "docs/examples/town.json"],
        ["metrics", "bridges"],
        ["generate", "--method", "luck", "--out", "x"],
        ["dataset", "--where", "cycles=3", "--out", "x"],
    ],
    ids=" ".join,
)
def test_commands_that_search_for_nothing_do_not_wait_for_jax(command):
    """Neither do searches that are refused."""
    program = f"import sys; from elitelanes_jax.cli.main import main; main({command!r}); print(); print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", program], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert not {name.split(".")[0] for name in ran.stdout.splitlines()[-1].split()} & {"jax", "jaxlib", "cv2", "scipy"}

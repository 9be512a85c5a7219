"""The house: imports between rooms go one way, modules say what is public, and nothing is loaded that is not needed."""

import ast
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import elitelanes_jax

PACKAGE = Path(elitelanes_jax.__file__).parent
MODULES = {
    ".".join((PACKAGE.name, *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): file
    for file in sorted(PACKAGE.rglob("*.py"))
}
TREES = {name: ast.parse(file.read_text(encoding="utf-8")) for name, file in MODULES.items()}
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef


def test_imports_keep_the_contracts():
    """The contracts between rooms are in pyproject.toml."""
    program = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    command = [sys.executable, "-c", program]
    ran = subprocess.run(command, cwd=PACKAGE.parent, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout


def test_imports_are_absolute():
    for name, tree in TREES.items():
        assert not [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level], name


def test_types_that_cannot_be_seen_have_names_and_reasons():
    """No other module uses `Any`."""

    def names(tree):
        imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module == "typing")
        return {one.name for node in imports for one in node.names}

    assert [name for name, tree in TREES.items() if "Any" in names(tree)] == ["elitelanes_jax._util.types"]


def test_one_scan_runs_all_optimizers():
    def scans(tree):
        called = (node.func for node in ast.walk(tree) if isinstance(node, ast.Call))
        return [function for function in called if isinstance(function, ast.Attribute) and function.attr == "scan"]

    assert [name for name, tree in TREES.items() if scans(tree)] == ["elitelanes_jax.optimizers.run"]


@pytest.mark.parametrize("name", [name for name, file in MODULES.items() if file.name != "__init__.py"])
def test_every_module_says_what_is_public(name):
    module = import_module(name)
    assert len(set(module.__all__)) == len(module.__all__)
    defined = [node for node in TREES[name].body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    public = {node.name for node in defined if not node.name.startswith("_")}
    assert public <= set(module.__all__)
    for exported in module.__all__:
        assert hasattr(module, exported)


@pytest.mark.parametrize("name", MODULES)
def test_docstrings_begin_with_a_verb_or_a_noun(name):
    tree = TREES[name]
    assert ast.get_docstring(tree)
    for node in ast.walk(tree):
        text = ast.get_docstring(node) if isinstance(node, DOCUMENTED) else None
        if text is not None:
            assert not re.match(r"(What|How|Which|Where|Who|When)\b", text), f"{name}: {text.splitlines()[0]}"


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
        "import elitelanes_jax, elitelanes_jax.spec, elitelanes_jax.dataset.spec, elitelanes_jax.plots;"
        "import elitelanes_jax.network.symmetry, elitelanes_jax.network.wfc, elitelanes_jax.formats.road_map;"
        "import elitelanes_jax.cli.main; elitelanes_jax.cli.main.make_parser();"
        "import sys; assert 'cv2' not in sys.modules;"
        "import elitelanes_jax.tiles.render"
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
    ran = subprocess.run(
        [sys.executable, "-c", program], cwd=PACKAGE.parent, capture_output=True, text=True, check=False
    )
    assert not {name.split(".")[0] for name in ran.stdout.splitlines()[-1].split()} & {"jax", "jaxlib", "cv2", "scipy"}


def test_the_package_says_what_it_has():
    assert dir(elitelanes_jax) == sorted(elitelanes_jax.__all__)
    for name in elitelanes_jax.__all__:
        assert getattr(elitelanes_jax, name) is not None
    with pytest.raises(AttributeError, match="nothing"):
        _ = elitelanes_jax.nothing

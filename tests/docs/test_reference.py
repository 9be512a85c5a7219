"""The reference shows the public names and their true defaults, and readers are shown a use of each."""

import ast
import re
import runpy
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from importlib import import_module
from inspect import isclass, isfunction, unwrap
from pathlib import Path
from types import ModuleType

import pytest
from pages import READERS, programs

import elitelanes_jax

griffe = pytest.importorskip("griffe")

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "docs" / "reference"
ROOMS = [name for name in elitelanes_jax.__all__ if isinstance(getattr(elitelanes_jax, name), ModuleType)]
FACES = [elitelanes_jax, *(getattr(elitelanes_jax, name) for name in ROOMS)]
PUBLIC = {f"{face.__name__}.{name}": getattr(face, name) for face in FACES for name in getattr(face, "__all__", ())}


@cache
def package():
    """The package as the reference reads it: by its sources."""
    extensions = griffe.load_extensions(str(ROOT / "docs" / "records.py"))
    return griffe.load("elitelanes_jax", search_paths=[str(ROOT)], extensions=extensions)


def test_each_room_has_a_page():
    pages = {file.stem: file.read_text(encoding="utf-8") for file in REFERENCE.glob("*.md") if file.stem != "index"}
    assert sorted(pages) == sorted(ROOMS)
    assert not [room for room, text in pages.items() if f"\n::: elitelanes_jax.{room}\n" not in text]


def test_a_page_begins_with_functions_and_ends_with_constants():
    for package in ("mkdocs", "nbconvert"):
        pytest.importorskip(package)
    reference = runpy.run_path(str(ROOT / "docs" / "hooks.py"))["_reference"]
    for room in ROOMS:
        names = re.findall(rf"^::: elitelanes_jax\.{room}\.(\w+)$", reference(f"elitelanes_jax.{room}"), re.MULTILINE)
        shown = [PUBLIC[f"elitelanes_jax.{room}.{name}"] for name in names]
        kinds = "".join("f" if isfunction(unwrap(one)) else "c" if isclass(one) else "v" for one in shown)
        assert re.fullmatch("f*c*v*", kinds), f"{room}: {kinds}"
    assert names, "some rooms list their names"


@pytest.mark.parametrize("path", PUBLIC)
def test_a_public_name_has_a_docstring(path):
    assert path.endswith("__version__") or package()[path.partition(".")[2]].has_docstring


def defaults_of(record):
    """Returns the defaults of a NamedTuple's or a dataclass' fields, by name."""
    if not is_dataclass(record):
        return record._field_defaults
    made = {
        one.name: one.default if one.default_factory is MISSING else one.default_factory() for one in fields(record)
    }
    return {name: default for name, default in made.items() if default is not MISSING}


RECORDS = {
    path: one for path, one in PUBLIC.items() if isclass(one) and (is_dataclass(one) or hasattr(one, "_field_defaults"))
}


@pytest.mark.parametrize("path", [path for path, record in RECORDS.items() if defaults_of(record)])
def test_a_record_shows_its_plain_defaults(path):
    read, record = package()[path.partition(".")[2]], RECORDS[path]
    names = vars(import_module(record.__module__))
    shown = {item.name: eval(str(item.default), names) for item in read.parameters if item.default is not None}
    assert shown == defaults_of(record)


def used(program):
    """The public names that a program imports, or takes from a room it imported: each with its identity."""
    tree = ast.parse(program)
    known = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "elitelanes_jax":
            known |= {
                name.asname or name.name: (name.name, getattr(import_module(node.module), name.name))
                for name in node.names
            }
        elif isinstance(node, ast.Import):
            names = [name for name in node.names if name.name.split(".")[0] == "elitelanes_jax"]
            known |= {
                name.asname or "elitelanes_jax": ("", import_module(name.name) if name.asname else elitelanes_jax)
                for name in names
            }
    yield from known.values()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            *_, room = known.get(ast.unparse(node.value), (None,))
            if isinstance(room, ModuleType):
                yield node.attr, getattr(room, node.attr)


def types_in_signatures():
    """The records that public functions and classes take or give, by their private paths."""
    for path in PUBLIC:
        read = package()[path.partition(".")[2]] if not path.endswith("__version__") else None
        parts = [read, *read.members.values()] if read is not None and not read.is_module else []
        for part in parts:
            annotations = [getattr(part, "annotation", None), getattr(part, "returns", None)]
            annotations += [parameter.annotation for parameter in getattr(part, "parameters", ())]
            for annotation in annotations:
                names = annotation.iterate() if isinstance(annotation, griffe.Expr) else ()
                yield from (name.canonical_path for name in names if isinstance(name, griffe.ExprName))


def test_each_public_name_is_used_where_readers_see_it():
    """In a program; or a page names it; or it is a record, and another public name takes or returns it."""
    files = [file for file in READERS if REFERENCE not in file.parents]
    shown = {(name, id(one)) for file in files for program in programs(file) for name, one in used(program)}
    written = "".join(file.read_text(encoding="utf-8") for file in files if file.suffix == ".md")
    types = set(types_in_signatures())

    def is_used(path, one):
        name = path.rpartition(".")[2]
        told = not name.isalpha() or not name.islower()  # `run` on a page may be another word
        on_page, in_signature = told and f"`{name}`" in written, isclass(one) and f"{one.__module__}.{name}" in types
        return (name, id(one)) in shown or on_page or in_signature

    unused = [path for path, one in PUBLIC.items() if not isinstance(one, ModuleType) and not is_used(path, one)]
    assert not unused, "\n".join(unused)

"""Builds the parts of the site that are not written by hand.

Links out of this folder work on the site as they do in a checkout: files that pages link to become part of the site,
notebooks as pages with their outputs. A link to a file of the package leads to the reference page of its room. The
reference is made from the rooms' lists of public names: a room's page shows each of them, and names between backticks
become links. The page on the explorer leads to a live one.
"""

import os
import re
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbconvert import MarkdownExporter

from elitelanes_jax.explorer import explore

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PACKAGE = ROOT / "elitelanes_jax"

_LINK = re.compile(r"\[([^\]]*)\]\(([^)#:\s]+)(#[^)\s]*)?\)")

_LIVE = "explore-live.html"

_DIRECTIVE = re.compile(r"^::: (elitelanes_jax\S*)$", re.MULTILINE)

_NAME = re.compile(r'(?<![b"]>)<code>(\w+)</code>')  # parameters are bold, and links have their target already


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the files outside this folder that pages link to, directly or through other pages, and the explorer."""
    with TemporaryDirectory() as folder:
        page = Path(folder, _LIVE)
        explore([DOCS / "examples" / "run"], page)
        files.append(File.generated(config, _LIVE, content=page.read_text(encoding="utf-8")))
    waiting = [Path(file.abs_src_path) for file in files.documentation_pages() if file.abs_src_path]
    seen = set(waiting)
    while waiting:
        page = waiting.pop()
        for _, link, _ in _LINK.findall(_text(page)):
            target = (page.parent / link).resolve()
            if target in seen or not target.is_file() or not _joins_site(target):
                continue
            seen.add(target)
            if target.suffix == ".ipynb":
                text, pictures = _notebook(target)
                files.append(File.generated(config, _place(target), content=text))
                for name, picture in pictures.items():
                    place = f"{target.parent.relative_to(ROOT).as_posix()}/{name}"
                    files.append(File.generated(config, place, content=picture))
            else:
                files.append(File.generated(config, _place(target), abs_src_path=str(target)))
            if target.suffix in (".md", ".ipynb"):
                waiting.append(target)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Writes out the reference's directives, and replaces links by links to the same files on the site."""
    if page.file.src_uri == "explore.md":
        live = f'<p><a href="{_LIVE}">Open the explorer of the run in the picture, live.</a></p>'
        markdown = markdown.replace("![", f"{live}\n\n![", 1)
    markdown = _DIRECTIVE.sub(lambda found: _reference(found[1]), markdown)
    here = Path(page.file.src_uri).parent
    source = Path(page.file.abs_src_path or ROOT / page.file.src_uri)  # a notebook's page has no file

    def replaced(found: re.Match[str]) -> str:
        text, link, anchor = found[1], found[2], found[3] or ""
        target = (source.parent / link).resolve()
        if not target.exists() or not target.is_relative_to(ROOT):
            return found[0]
        if target.is_relative_to(PACKAGE):
            room = target.relative_to(PACKAGE).parts[0].partition(".")[0].replace("__init__", "index")
            listed = DOCS / "reference" / f"{room}.md"
            return f"[{text}]({os.path.relpath(_place(listed), here)})" if listed.exists() else text
        if target.is_dir():
            return text  # the site shows no folders
        return f"[{text}]({os.path.relpath(_place(target), here)}{anchor})"

    return _LINK.sub(replaced, markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Makes links of the package's names that docstrings have between backticks."""

    def linked(found: re.Match[str]) -> str:
        path = _paths().get(found[1])
        return f'<autoref identifier="{path}" optional>{found[0]}</autoref>' if path else found[0]

    return _NAME.sub(linked, html) if page.file.src_uri.startswith("reference/") else html


def _reference(path: str) -> str:
    """Returns the Markdown of a directive: the names of a room in full, or tables of the whole package."""
    face = import_module(path)
    if path != "elitelanes_jax":
        if not hasattr(face, "__all__"):
            return f"::: {path}"
        names = sorted(face.__all__, key=lambda name: _rank(f"{path}.{name}"))
        return "\n\n".join([face.__doc__ or "", *(f"::: {path}.{name}" for name in names)])
    rooms = [name for name in face.__all__ if isinstance(getattr(face, name), ModuleType)]
    others = [name for name in face.__all__ if name not in [*rooms, "__version__"]]
    others.sort(key=lambda name: _rank(_paths()[name]))
    own = [name for name in others if _paths()[name] == f"{path}.{name}"]
    return "\n\n".join(
        [
            _table((f"[`{name}`][{_paths()[name]}]", name) for name in others if name not in own),
            "Each room has a page:",
            _table((f"[{name}]({name}.md)", name) for name in rooms),
            *(f"::: {path}.{name}" for name in own),
        ]
    )


def _rank(path: str) -> int:
    """Returns the rank of a name on a page: functions come first, then classes, then constants."""
    kind = _package()[path.partition(".")[2]].kind
    return {griffe.Kind.FUNCTION: 0, griffe.Kind.CLASS: 1}.get(kind, 2)


def _table(rows: Iterator[tuple[str, str]]) -> str:
    return "\n".join(["| | |", "|---|---|", *(f"| {link} | {_first_sentence(name)} |" for link, name in rows)])


def _first_sentence(name: str) -> str:
    docstring = _package()[name].docstring
    return re.split(r"(?<=\.)\s|\n\n", docstring.value if docstring else "")[0].replace("\n", " ")


@cache
def _package() -> griffe.Object | griffe.Alias:
    return griffe.load("elitelanes_jax", search_paths=[str(ROOT)])


@cache
def _paths() -> dict[str, str]:
    """Returns the public paths of all names, by name: in its room if it has one."""
    top = import_module("elitelanes_jax")
    rooms = [getattr(top, name) for name in top.__all__ if isinstance(getattr(top, name), ModuleType)]
    return {name: f"{face.__name__}.{name}" for face in (top, *rooms) for name in getattr(face, "__all__", ())}


def _joins_site(target: Path) -> bool:
    return target.is_relative_to(ROOT) and not target.is_relative_to(DOCS) and not target.is_relative_to(PACKAGE)


def _text(page: Path) -> str:
    return _notebook(page)[0] if page.suffix == ".ipynb" else page.read_text(encoding="utf-8")


@cache
def _notebook(file: Path) -> tuple[str, dict[str, bytes]]:
    """Returns the text of a notebook's page, and its pictures by name."""
    settings = {"unique_key": file.stem, "output_files_dir": f"{file.stem}_files"}
    text, resources = MarkdownExporter().from_filename(str(file), resources=settings)
    return text, resources["outputs"]


def _place(target: Path) -> str:
    """Returns the place of a file of the repository on the site."""
    if target == ROOT / "README.md":
        return "readme.md"  # mkdocs would make the start page of it
    home = DOCS if target.is_relative_to(DOCS) else ROOT
    return target.relative_to(home).as_posix().replace(".ipynb", ".md")

"""Lets mkdocs follow links out of this folder, so that those which work in a checkout work on the site too.

What a page links to elsewhere in the repository comes onto the site: other pages, with what they link to, and files;
notebooks as pages with what they show. A link to a module of the package leads to its place in the reference, and so do
names there, such as `evolve`.
"""

import ast
import os
import re
from functools import cache
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbconvert import MarkdownExporter

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PACKAGE = ROOT / "elitelanes_jax"

_LINK = re.compile(r"\[([^\]]*)\]\(([^)#:\s]+)(#[^)\s]*)?\)")

_NAME = re.compile(r'(?<![b"]>)<code>(\w+)</code>')  # but for parameters, which are bold, and links


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the files outside this folder that pages link to, directly or not."""
    waiting = [Path(file.abs_src_path) for file in files.documentation_pages() if file.abs_src_path]
    seen = set(waiting)
    while waiting:
        page = waiting.pop()
        for _, link, _ in _LINK.findall(_text(page)):
            target = (page.parent / link).resolve()
            if target in seen or not target.is_file() or not _is_brought(target):
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
    """Turns the links on a page to where their targets are on the site."""
    source = Path(page.file.abs_src_path or ROOT / page.file.src_uri)  # a notebook's page has no file

    def turned(found: re.Match[str]) -> str:
        text, link, anchor = found[1], found[2], found[3] or ""
        target = (source.parent / link).resolve()
        if not target.exists() or not target.is_relative_to(ROOT):
            return found[0]
        if target.is_relative_to(PACKAGE):
            return f"[{text}][{'.'.join(target.relative_to(ROOT).with_suffix('').parts)}]"
        if target.is_dir():
            return text  # the site has no folders to look into
        return f"[{text}]({os.path.relpath(_place(target), Path(page.file.src_uri).parent)}{anchor})"

    return _LINK.sub(turned, markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turns names of ours that docstrings have between backticks into links to where they are explained."""

    def linked(found: re.Match[str]) -> str:
        home = _homes().get(found[1])
        return f'<autoref identifier="{home}" optional>{found[0]}</autoref>' if home else found[0]

    return _NAME.sub(linked, html) if page.file.src_uri.startswith("reference/") else html


@cache
def _homes() -> dict[str, str]:
    """The full names of public functions and classes, but for those that mean something else elsewhere."""
    homes: dict[str, str] = {}
    meant: set[str] = set()
    for file in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(file.relative_to(ROOT).with_suffix("").parts)
        tree = ast.parse(file.read_text(encoding="utf-8"))
        meant |= {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                meant |= {node.name} & set(homes)
                homes[node.name] = f"{module}.{node.name}"
                fields = [field.target for field in node.body if isinstance(field, ast.AnnAssign)]
                meant |= {field.id for field in fields if isinstance(field, ast.Name)}
    return {name: home for name, home in homes.items() if name not in meant}


def _is_brought(target: Path) -> bool:
    return target.is_relative_to(ROOT) and not target.is_relative_to(DOCS) and not target.is_relative_to(PACKAGE)


def _text(page: Path) -> str:
    return _notebook(page)[0] if page.suffix == ".ipynb" else page.read_text(encoding="utf-8")


@cache
def _notebook(file: Path) -> tuple[str, dict[str, bytes]]:
    """The text of a notebook's page, and its pictures by name."""
    settings = {"unique_key": file.stem, "output_files_dir": f"{file.stem}_files"}
    text, resources = MarkdownExporter().from_filename(str(file), resources=settings)
    return text, resources["outputs"]


def _place(target: Path) -> str:
    """Where a file of the repository is on the site."""
    if target == ROOT / "README.md":
        return "readme.md"  # mkdocs would make the start page of it
    home = DOCS if target.is_relative_to(DOCS) else ROOT
    return target.relative_to(home).as_posix().replace(".ipynb", ".md")

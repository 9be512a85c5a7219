"""Makes links out of this folder work on the site as they do in a checkout.

Files elsewhere in the repository that pages link to become part of the site: pages with the files that they link to,
notebooks as pages with their outputs. A link to a module of the package leads to its place in the reference, and so do
names in the reference, such as `evolve`. The page on the explorer leads to a live one.
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

from elitelanes_jax.explorer import collect, page_of

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PACKAGE = ROOT / "elitelanes_jax"

_LINK = re.compile(r"\[([^\]]*)\]\(([^)#:\s]+)(#[^)\s]*)?\)")

_LIVE = "explore-live.html"

_NAME = re.compile(r'(?<![b"]>)<code>(\w+)</code>')  # but for parameters, which are bold, and links


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the files outside this folder that pages link to, directly or through other pages, and the explorer."""
    run = collect([DOCS / "examples" / "run"], title="MAP-Elites, 8 x 8 tiles")
    files.append(File.generated(config, _LIVE, content=page_of(run)))
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
    """Replaces the links on a page by links to the places of their targets on the site."""
    if page.file.src_uri == "explore.md":
        live = f'<p><a href="{_LIVE}">Open the explorer of the run in the picture, live.</a></p>'
        markdown = markdown.replace("![", f"{live}\n\n![", 1)
    source = Path(page.file.abs_src_path or ROOT / page.file.src_uri)  # a notebook's page has no file

    def replaced(found: re.Match[str]) -> str:
        text, link, anchor = found[1], found[2], found[3] or ""
        target = (source.parent / link).resolve()
        if not target.exists() or not target.is_relative_to(ROOT):
            return found[0]
        if target.is_relative_to(PACKAGE):
            return f"[{text}][{'.'.join(target.relative_to(ROOT).with_suffix('').parts)}]"
        if target.is_dir():
            return text  # the site shows no folders
        return f"[{text}]({os.path.relpath(_place(target), Path(page.file.src_uri).parent)}{anchor})"

    return _LINK.sub(replaced, markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Makes links of the package's names that docstrings have between backticks."""

    def linked(found: re.Match[str]) -> str:
        home = _homes().get(found[1])
        return f'<autoref identifier="{home}" optional>{found[0]}</autoref>' if home else found[0]

    return _NAME.sub(linked, html) if page.file.src_uri.startswith("reference/") else html


@cache
def _homes() -> dict[str, str]:
    """Returns the full names of public functions and classes, but for names that are also arguments or fields."""
    homes: dict[str, str] = {}
    ambiguous: set[str] = set()
    for file in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(file.relative_to(ROOT).with_suffix("").parts)
        tree = ast.parse(file.read_text(encoding="utf-8"))
        ambiguous |= {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                ambiguous |= {node.name} & set(homes)
                homes[node.name] = f"{module}.{node.name}"
                fields = [field.target for field in node.body if isinstance(field, ast.AnnAssign)]
                ambiguous |= {field.id for field in fields if isinstance(field, ast.Name)}
    return {name: home for name, home in homes.items() if name not in ambiguous}


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

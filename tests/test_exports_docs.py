"""The page on exports: its commands and its program run, and print what it shows; its tables say what there is."""

import re
import shlex
from pathlib import Path

import pytest
from pages import blocks, run_program

from elitelanes_jax.cli import main
from elitelanes_jax.exports.command import _FORMATS, _STREETS, _TABLES
from elitelanes_jax.exports.duckietown import GROUNDS, TILE_SIZE
from elitelanes_jax.exports.sumo import _RIGHTS_OF_WAY, Streets

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "exports.md").read_text()
TABLES = dict(re.findall(r"^\| `(.*?)[` ].*?\| (.*) \|$", PAGE, re.MULTILINE))

pytestmark = pytest.mark.usefixtures("own_compile_cache")


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """A folder that has the page's examples, and where its commands may write."""
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(tmp_path)


def commands(text):
    return [shlex.split(line)[1:] for line in text.splitlines()]


def test_commands_print_what_is_shown(repository, capsys):
    shown = 0
    parts = blocks(PAGE, "sh", "text", "yaml")
    for (language, text), (next_language, output) in zip(parts, [*parts[1:], ("", "")], strict=True):
        for command in commands(text) if language == "sh" else ():
            assert command[0] == "generate" or main(command) == 0
        printed = capsys.readouterr().out
        if language == "sh" and next_language == "text":
            assert printed == output
            shown += 1
        if language == "yaml":
            assert Path("towns/village.yaml").read_text() == text
            shown += 1
    assert shown == 3
    written = {str(file) for file in Path().rglob("*.*") if file.is_file()}
    assert {f"plain/town.{kind}.xml" for kind in ("nod", "edg", "con")} < written
    assert {"town.yaml", "tiles.graphml", "crossings.graphml", "metrics.csv", "metrics.json"} < written


@pytest.mark.slow
def test_a_search_begins_with_the_town_that_is_written(repository):
    written, (search,) = (
        [command for _, text in blocks(PAGE, "sh") for command in commands(text) if words <= set(command)]
        for words in ({"town.yaml", "export"}, {"generate"})
    )
    assert [main(command) for command in (*written, search)] == [0, 0]


def test_the_program_prints_what_it_says(capsys):
    ((_, program),) = blocks(PAGE, "python")
    run_program(program, "exports.md", capsys)


def test_tables_are_what_there_is():
    for name, form in _FORMATS.items():
        assert TABLES[name].partition(" |")[0] == ", ".join(f"`{suffix}`" for suffix in form.suffixes)
    assert f"| {', '.join(f'`{name}`' for name in _TABLES)} |" in PAGE
    ways = re.findall(r"`(\w+)`", TABLES["--right-of-way"])
    assert set(re.findall(r"`(\w+)`", TABLES["--ground"])) - {"duckietown"} == set(GROUNDS)
    assert set(ways) == set(_RIGHTS_OF_WAY) and ways[0] == Streets().right_of_way
    assert f"{TILE_SIZE} in `duckietown`, {Streets().tile:g} in `sumo`" in TABLES["--tile-size"]
    for name in ("lane", "speed"):
        assert TABLES[f"--{name}"].endswith(f"; {getattr(Streets(), name)}")
    assert all(f"--{name.replace('_', '-')}" in TABLES for name in _STREETS)


def test_links_and_targets_are_there():
    heads = {head.lower().replace(" ", "-") for head in re.findall(r"^## (.*)$", PAGE, re.MULTILINE)}
    for link in re.findall(r"\]\((?!https?:)([^)]+)\)", PAGE):
        file, _, anchor = link.partition("#")
        assert (ROOT / "docs" / file).exists() and (file or anchor in heads), link
    for target in re.findall(r"`make (\S+)`", PAGE):
        assert f"\n{target}:" in (ROOT / "Makefile").read_text()

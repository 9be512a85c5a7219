"""The page on exports: its commands and its program run, and print what it shows; its tables are complete."""

import re
import shutil
from pathlib import Path

import pytest
from pages import blocks, commands, run_program
from refusals import refused

from elitelanes_jax.cli.export import FORMATS
from elitelanes_jax.cli.main import main, make_parser
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.streets import Streets

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "exports.md").read_text(encoding="utf-8")
TABLES = dict(re.findall(r"^\| `(.*?)[` ].*?\| (.*) \|$", PAGE, re.MULTILINE))
LOOP = [[6, 3], [12, 9]]


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """A folder that has the page's examples, and where its commands may write."""
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(tmp_path)


def test_commands_print_what_is_shown(repository, capsys):
    shown = 0
    parts = blocks(PAGE, "sh", "text", "yaml")
    for (language, text), (next_language, output) in zip(parts, [*parts[1:], ("", "")], strict=True):
        for command in commands(f"```sh\n{text}```") if language == "sh" else ():
            assert command[0] == "generate" or main(command) == 0
        printed = capsys.readouterr().out
        if language == "sh" and next_language == "text":
            assert printed == output
            shown += 1
        if language == "yaml":
            assert Path("exported-towns/village.yaml").read_text() == text
            shown += 1
    assert shown == 3
    written = {str(file) for file in Path().rglob("*.*") if file.is_file()}
    assert {f"network/town.{kind}" for kind in ("nod.xml", "edg.xml", "con.xml", "netccfg")} < written
    assert {"exported.yaml", "metrics.csv"} < written


def test_commands_for_simulators_run(repository, capsys):
    page = (ROOT / "docs" / "simulators.md").read_text(encoding="utf-8")
    options = re.findall(r"^\| [^|]*\| `(--to \S+ --out \S+)` \|", page, re.MULTILINE)
    listed = [f"export map.json {each}" for each in dict.fromkeys(options)]
    shutil.copy("docs/examples/town.json", "map.json")
    assert len(listed) == 12
    for command in listed:
        assert main(command.split()) == 0, command
        assert Path(command.split()[-1]).exists()


@pytest.mark.slow
def test_a_search_begins_with_the_town_that_is_written(repository):
    (written,) = (command for command in commands(PAGE) if {"exported.yaml", "export"} <= set(command))
    (search,) = (command for command in commands(PAGE) if command[0] == "generate")
    assert [main(written), main(search)] == [0, 0]


@pytest.mark.parametrize("program", [text for _, text in blocks(PAGE, "python")])
def test_programs_print_what_they_say(program, repository, capsys):
    run_program(program, "exports.md", capsys)


def test_the_table_has_all_formats(capsys):
    with pytest.raises(SystemExit):
        make_parser().parse_args(["export", "--help"])
    formats = re.search(r"--to FORMAT\s+([\w,\s-]+?)\n\s+--", capsys.readouterr().out)[1].split()
    listed = re.findall(r"^\| (`[^|]*?) \|", PAGE.partition("| option |")[0], re.MULTILINE)
    assert sorted(name.strip(",") for name in formats) == sorted(re.findall(r"`([\w-]+)`", " ".join(listed)))


@pytest.mark.parametrize("name", sorted({*FORMATS} - {"dt-maps", "duckiematrix"}))
def test_files_end_as_the_table_says(name, repository, capsys):
    assert main(["export", "docs/examples/town.json", "--to", name, "--out", "out"]) == 0
    said = re.findall(r"`(\S+)`", TABLES[name].partition(" |")[0])
    expected = {f"town{name}" if name.startswith(".") else name.replace("*", "town") for name in said}
    assert {file.name for file in Path("out").iterdir()} == expected


def test_values_of_options_are_those_of_the_formats():
    ways = re.findall(r"`(\w+)`", TABLES["--right-of-way"])
    assert ways[0] == Streets().right_of_way
    with refused("right_of_way", "'none'"):
        Streets(right_of_way="none")
    duckietowns = f"{TILE_SIZE} in `duckietown`, `dt-maps` and `duckiematrix`"
    assert f"{duckietowns}, {Streets().tile_size:g} in `sumo`" in TABLES["--tile-size"]
    for name in ("lane", "speed"):
        assert TABLES[f"--{name}"].endswith(f"; {getattr(Streets(), name)}")

"""All written pages: their programs run, their commands are accepted, their links lead somewhere.

This module runs all programs, so that those with the same shapes and methods share compiled code.
"""

import dataclasses
import re
import shlex
import shutil
import tomllib
from collections import Counter
from importlib.util import find_spec
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import photographed
import pytest
from pages import blocks, commands, run_program

from elitelanes_jax import DatasetSpec, GenerateSpec, RoadMap, load_tiles, read_map
from elitelanes_jax._util import packages
from elitelanes_jax.cli.arguments import read_options
from elitelanes_jax.cli.main import main, make_parser
from elitelanes_jax.drive import LaneDriveParams, RoadNavParams, RoadTrafficParams
from elitelanes_jax.formats.duckietown import to_duckietown
from elitelanes_jax.formats.road_map import map_to_json
from elitelanes_jax.network.wfc import generate_batch
from elitelanes_jax.tiles.masking import COLOURS, parse_colour
from elitelanes_jax.tiles.tileset import inspect_tiles

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
FILES = [
    *ROOT.glob("*.md"),
    *DOCS.rglob("*.md"),
    *(ROOT / "experiments").glob("**/README.md"),
    ROOT / "experiments/search/moves.md",
]
PAGES = {file.relative_to(ROOT).as_posix(): file.read_text(encoding="utf-8") for file in sorted(FILES)}
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")

# Pages whose programs other tests run.
RUN_ELSEWHERE = [f"docs/{name}.md" for name in ("benchmark", "exports", "interop", "plots", "scaling", "tiles", "ued")]
# Pages whose programs take long. The tests of their rooms are quick.
SLOW_PAGES = ("experiments", "docs/choosing", "docs/drive", "docs/explore")
PROGRAMS = [
    pytest.param(page, text, marks=[pytest.mark.slow] if page.startswith(SLOW_PAGES) else [])
    for page in PAGES
    if page not in RUN_ELSEWHERE
    for _, text in blocks(PAGES[page], "python")
    if "import torch" not in text  # make yolo runs it
]

# What a program imports that not every environment has.
EXTRAS = {"import gymnasium": "gymnasium", "import stable_baselines3": "stable_baselines3", "import show": "anywidget"}


@pytest.mark.parametrize(("page", "program"), PROGRAMS)
def test_programs_run_and_print_what_they_say(page, program, capsys, tmp_path, monkeypatch):
    for words, package in EXTRAS.items():
        if words in program:
            pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    shutil.copytree(DOCS / "examples", "docs/examples")
    for folder in re.findall(r'Path\("([\w-]+/maps)"\)', program):  # that the command before it writes
        for number in range(2):
            file = Path(f"{folder}/{number:04d}/map.json")
            file.parent.mkdir(parents=True)
            file.write_text(map_to_json(RoadMap(np.array([[6, 7, 3], [12, 13, 9]]))))
    run_program(program, page, capsys)


@pytest.mark.slow
def test_the_page_on_driving_leads_from_maps_to_a_film(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("docs").symlink_to(DOCS)
    generate, film = (command for command in commands(PAGES["docs/drive.md"]) if command[-1] in ("drive-maps", "20"))
    assert main(generate) == 0
    (program,) = (text for _, text in blocks(PAGES["docs/drive.md"], "python") if "drive-maps/maps" in text)
    run_program(program, "docs/drive.md", capsys)
    assert main(film) == 0
    assert Path("trained.mp4").stat().st_size > 10_000


def test_the_page_on_driving_has_the_rewards_of_each_environment():
    """Nobody found what a step is worth without the docstrings."""
    rows = [line.split(" | ") for line in PAGES["docs/drive.md"].splitlines()]
    columns = [next(row[1:] for row in rows if row[0] == f"| {name}") for name in ("rewards and costs", "truncated")]
    for number, options in enumerate((RoadNavParams, LaneDriveParams, RoadTrafficParams)):
        defaults = {field.name: field.default for field in dataclasses.fields(options)}
        costs = {name: value for name, value in defaults.items() if name.endswith(("_cost", "_reward")) and value}
        said = dict(re.findall(r"`(\w+)` ([\d.]*\d)", columns[0][number]))
        assert {name: float(value) for name, value in said.items()} == costs
        assert columns[1][number].strip(" |") == f"at `limit` {defaults['limit']}"


@pytest.mark.parametrize("page", [page for page in PAGES if commands(PAGES[page])])
def test_commands_are_accepted(page, tmp_path, monkeypatch):
    """Values of options are checked too, with files of the names that pages use."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(DOCS / "examples", "docs/examples")
    town = DOCS / "examples" / "town.json"
    Path("exported.yaml").write_text(to_duckietown(read_map(town).codes))
    for name in ("plan.json", "other.json"):
        shutil.copy(town, name)
    made = {command[command.index("--out") + 1] for command in commands(PAGES[page]) if command[0] == "generate"}
    grids = generate_batch(np.random.default_rng(0), 10, (12, 12), border="closed").grid
    for folder, number in product({"maps", *made}, range(10)):
        file = Path(f"{folder}/maps/{number:04d}/map.json")
        file.parent.mkdir(parents=True)
        file.write_text(map_to_json(RoadMap(grids[number])))
    Path("selection.json").write_text(
        "[{}]".format(", ".join(file.read_text() for file in Path("maps").rglob("*.json")))
    )
    for command in commands(PAGES[page]):
        options = make_parser().parse_args(command)
        assert callable(options.action)
        defaults = {"generate": GenerateSpec(), "dataset": DatasetSpec()}.get(command[0])
        if defaults is not None:
            assert type(read_options(options, defaults)) is type(defaults)


def test_no_two_commands_write_one_output():
    """So the commands of all pages run in one folder, one page after another."""
    lines = [line for text in PAGES.values() for line in re.findall("^(?:elitelanes|python -m) .*", text, re.MULTILINE)]
    written = [word for line in lines if "--force" not in line for word in re.findall(r" --out (\S+)", line)]
    assert not [name for name, times in Counter(written).items() if times > 1]


def test_all_extras_are_listed():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    (listed,) = re.findall(r"\| extras \|.*?\n\n", PAGES["docs/install.md"], re.DOTALL)
    rows = re.findall(r"^\| (`.*?`) \|", listed, re.MULTILINE)
    assert sorted(name.strip("`") for row in rows for name in row.split(", ")) == sorted(extras)


def test_messages_name_extras_that_bring_the_package():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    for module, extra in packages.EXTRAS.items():
        assert module in {re.split("[^a-z0-9-]", requirement)[0] for requirement in extras[extra]}


def test_given_cells_on_the_page_are_those_of_the_file():
    (rows,) = re.findall(r"```json\n(.*?)```", PAGES["docs/generate.md"], re.DOTALL)
    assert rows == (DOCS / "examples" / "city.json").read_text()


def test_no_item_of_a_list_is_within_another():
    """A program that wraps lines joins the items of a list."""
    for page, text in PAGES.items():
        assert not re.search(r"\w[.:] - [A-Z`]", text), page


def test_links_targets_and_scripts_are_there():
    for page, text in PAGES.items():
        for link in re.findall(r"\]\((?!https?:)([^)#]+)[^)]*\)", text):
            assert (ROOT / page).parent.joinpath(link).exists(), f"{page}: {link}"
        for target in re.findall(r"(?:^|`)make (?:[A-Z]+=\S+ )*([\w-]+)", text, re.MULTILINE):
            assert f"\n{target}:" in MAKEFILE, f"{page}: make {target}"
        for script in re.findall(r"python ((?:docs|notebooks)/\w+\.py)", text):
            assert (ROOT / script).exists(), f"{page}: {script}"
        for module in re.findall(r"python -m (experiments[\w.]+)", text):
            assert find_spec(module), f"{page}: {module}"
        studies = re.findall(r"STUDY=([a-z.]+)", text)
        if page == "docs/make.md":
            studies += re.findall(r"`((?:navigation|paper|perception|search)\.[a-z_]+)`", text)
        for study in studies:
            assert find_spec(f"experiments.{study}"), f"{page}: {study}"


@pytest.mark.parametrize(
    ("page", "names"),
    [
        ("generate", ["generate"]),
        ("pick", ["pick"]),
        ("pack", ["pack"]),
        ("render", ["render"]),
        ("dataset", ["dataset"]),
        ("exports", ["export", "show"]),
        ("explore", ["explore"]),
        ("plan", ["plan"]),
        ("furnish", ["furnish"]),
    ],
)
def test_the_table_on_a_command_has_all_its_options(page, names, capsys):
    for name in names:
        with pytest.raises(SystemExit):
            make_parser().parse_args([name, "--help"])
    table = "".join(re.findall(r"^\| `.*?\|", PAGES[f"docs/{page}.md"], re.MULTILINE))
    listed, helped = (set(re.findall(r"--[a-z-]+", text)) for text in (table, capsys.readouterr().out))
    assert listed - {"--format"} == helped - {"--help", "--format"}


EXPERIMENTS = sorted(
    {
        (module, arguments)
        for page in PAGES.values()
        for module, arguments in re.findall(r"python -m (experiments[.\w]+)((?: [^`\n#]+)?)", page)
    }
)


@pytest.mark.parametrize(("module", "arguments"), EXPERIMENTS)
def test_commands_of_experiments_are_accepted(module, arguments, monkeypatch):
    experiment = pytest.importorskip(module, exc_type=ImportError)
    monkeypatch.setattr(experiment, "run", lambda program, work: 0)
    assert experiment.main(shlex.split(arguments)) == 0


@pytest.fixture
def photographs(tmp_path, monkeypatch):
    """A folder with photographs of a floor and of single tiles, and two maps."""
    monkeypatch.chdir(tmp_path)
    photographed.draw_photographs(tmp_path)


@pytest.mark.usefixtures("photographs")
def test_the_way_from_photographs_to_a_tile_set(capsys):
    """The page on tiles, step by step, without the commands that evolve maps."""
    page, said = PAGES["docs/tiles.md"], ""
    for language, text in blocks(page, "python", "sh"):
        if language == "python":
            exec(compile(text, "docs/tiles.md", "exec"), {})
        for line in text.splitlines() if language == "sh" else ():
            if line.startswith("elitelanes tiles"):
                assert main(shlex.split(line)[1:]) == 0
                said += capsys.readouterr().out
    printed = re.findall(r"```\n(9 tiles.*?|  A B C\n.*?)```", page, re.DOTALL)
    assert len(printed) == 2
    assert all(text in said for text in printed)
    # Through a slanted photograph, JPEG and back, the masks are still those of the tile.
    cut, given = load_tiles("my-tiles").tiles[0], load_tiles().tiles[0]
    assert cut.code == photographed.TOWN[0, 0]
    for name in ("road", "yellow"):
        drawn = np.rot90(getattr(given, name), 1).astype(np.uint8)
        mask = cv2.resize(drawn, cut.road.shape, interpolation=cv2.INTER_NEAREST) > 0
        assert (mask & getattr(cut, name)).sum() > 0.6 * (mask | getattr(cut, name)).sum()


def test_the_colours_on_the_page_are_the_defaults():
    said = dict(re.findall(r"--(road|red|yellow) (\S+)", PAGES["docs/tiles.md"]))
    assert {name: parse_colour(text) for name, text in said.items()} == COLOURS


def test_the_example_file_can_be_read(tmp_path):
    (example,) = re.findall(r"```toml\n(.*?)```", PAGES["docs/tiles.md"], re.DOTALL)
    (tmp_path / "tileset.toml").write_text(example)
    assert not [line for line in inspect_tiles(tmp_path)[1] if "tileset.toml" in line]

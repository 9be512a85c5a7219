"""The pages in docs: their programs run, their commands are understood, their links lead somewhere."""

import re
import runpy
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
from pages import blocks, run_program

import elitelanes_jax
from elitelanes_jax.cli import _parser, main
from elitelanes_jax.masking import COLOURS, read_colour
from elitelanes_jax.tile_files import read_points
from elitelanes_jax.tilesets import check_tiles, load_tiles

DOCS = Path(__file__).parents[1] / "docs"
PAGES = {file.relative_to(DOCS).as_posix(): file.read_text() for file in sorted(DOCS.rglob("*.md"))}
EXPERIMENTS = (DOCS.parent / "experiments" / "README.md").read_text()

OWN_TESTS = ("exports.md", "interop.md", "plots.md", "sumo.md", "tiles.md")  # pages whose programs are run elsewhere


def commands(page):
    lines = [line for _, text in blocks(PAGES[page], "sh") for line in text.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith("elitelanes ")]


def test_commands_are_understood():
    understood = [_parser().parse_args(command).run for page in PAGES for command in commands(page)]
    assert len(understood) >= 5


def test_links_lead_somewhere():
    for page, text in PAGES.items():
        for link in re.findall(r"\]\((?!https?:)([^)]+)\)", text):
            assert (DOCS / page).parent.joinpath(link.partition("#")[0]).exists(), f"{page}: {link}"


@pytest.mark.parametrize(
    ("page", "names"), [("generate.md", ["generate"]), ("render.md", ["render"]), ("exports.md", ["export", "show"])]
)
def test_the_table_on_a_command_has_all_its_options(page, names, capsys):
    for name in names:
        with pytest.raises(SystemExit):
            _parser().parse_args([name, "--help"])
    table = "".join(re.findall(r"^\| `.*?\|", PAGES[page], re.MULTILINE))
    options = [set(re.findall(r"--[a-z-]+", text)) for text in (table, capsys.readouterr().out)]
    assert options[0] == options[1] - {"--help"}


def test_figures_of_methods_are_those_of_the_experiments():
    text = re.sub(r"```.*?```", "", PAGES["choosing.md"], flags=re.DOTALL)
    figures = set(re.findall(r"-?\d[\d,]*[.,]\d+", text))
    assert len(figures) > 15
    assert not {figure for figure in figures if figure not in EXPERIMENTS}


def test_the_reference_lists_what_the_package_has():
    assert all(f"`{name}`" in PAGES["reference/index.md"] for name in elitelanes_jax.__all__)


@pytest.mark.parametrize(
    ("page", "program"),
    [(page, text) for page in PAGES if page not in OWN_TESTS for _, text in blocks(PAGES[page], "python")],
)
def test_programs_run_and_print_what_they_say(page, program, capsys):
    run_program(program, page, capsys)


@pytest.fixture
def photographs(tmp_path, monkeypatch, drawn_tiles):
    """A folder with a photograph of the first tile, and the pictures of all others as if they were cropped already."""
    monkeypatch.chdir(tmp_path)
    script = runpy.run_path(str(DOCS / "tiles.py"))
    Path("photos").mkdir()
    cv2.imwrite("photos/turn.jpg", script["photograph"](drawn_tiles.tiles[0].image)[..., ::-1])
    for tile in drawn_tiles.tiles[1:]:
        Path("my-tiles", tile.name).mkdir(parents=True)
        cv2.imwrite(f"my-tiles/{tile.name}/image.png", tile.image[..., ::-1])


def test_the_way_from_photographs_to_a_tile_set(photographs, drawn_tiles, capsys):
    """The page on tiles, step by step; the last one, which evolves maps, is tested elsewhere."""
    for language, text in blocks(PAGES["tiles.md"], "python", "sh"):
        if language == "python":
            exec(compile(text, "docs/tiles.md", "exec"), {})
        for line in text.splitlines() if language == "sh" else ():
            if line.startswith("elitelanes tiles"):
                assert main(shlex.split(line)[1:]) == 0
    capsys.readouterr()
    tiles = load_tiles("my-tiles")
    assert [tile.name for tile in tiles.tiles] == [tile.name for tile in drawn_tiles.tiles]
    assert {file.name for file in Path().iterdir()} == {"photos", "my-tiles", "sheet.png", "worst-seam.png"}
    # Through a slanted photograph, JPEG and back, the masks are still those of the tile.
    own, given = tiles.tiles[0], drawn_tiles.tiles[0]
    for name in ("road", "yellow"):
        mask = cv2.resize(getattr(given, name).astype(np.uint8), (512, 512), interpolation=cv2.INTER_NEAREST) > 0
        assert (mask & getattr(own, name)).sum() > 0.85 * (mask | getattr(own, name)).sum()


def test_the_ranges_on_the_page_are_the_ones_that_are_used():
    said = dict(re.findall(r"--(road|red|yellow) (\S+)", PAGES["tiles.md"]))
    assert {name: read_colour(text) for name, text in said.items()} == COLOURS


def test_the_example_files_are_ones_that_are_read(tmp_path):
    (example,) = re.findall(r"```toml\n(.*?)```", PAGES["tiles.md"], re.DOTALL)
    (points,) = re.findall(r"```json\n(.*?)```", PAGES["tiles.md"], re.DOTALL)
    (tmp_path / "turn_2").mkdir()
    (tmp_path / "tileset.toml").write_text(example)
    (tmp_path / "points.json").write_text(points)
    problems = []
    assert set(read_points(tmp_path / "points.json", np.zeros((512, 512), np.uint8), problems)) == {"cones", "duck"}
    assert not problems
    assert not [line for line in check_tiles(tmp_path)[1] if "tileset.toml" in line]

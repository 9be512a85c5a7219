"""--force replaces a folder of an earlier run, and no folder with anything else in it."""

import json
import shlex
import shutil
from pathlib import Path

import pytest
from folders import files
from refusals import refused

from elitelanes_jax import (
    GenerateSpec,
    PickSpec,
    SearchSpec,
    generate,
    pick,
)
from elitelanes_jax.cli.main import main

DRAWN = Path(__file__).parents[2] / "tiles"
SMALL = ["generate", "--size", "5", "6", "--seeds", "3", "--generations", "5", "--tile-px", "16", "--quiet"]
SMALL += ["--method", "ea", "--preset", "paper"]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("written") / "out"
    assert main([*SMALL, "--maps", "3", "--furnish", "lane_duckies=1", "--out", str(out)]) == 0
    return out


@pytest.fixture
def folder(written, tmp_path):
    return Path(shutil.copytree(written, tmp_path / "out"))


def test_a_folder_of_ours_is_replaced_if_that_is_asked_for(folder, capsys):
    before = files(folder)
    command = [*SMALL, "--maps", "2", "--seed", "3", "--out", str(folder)]
    assert main(command) == 2
    assert capsys.readouterr().err.endswith("got one with files in it; --force replaces it\n")
    assert files(folder) == before
    assert main([*command, "--force"]) == 0
    after = files(folder)
    assert {name.split("/")[1] for name in after if name.startswith("maps/")} == {"0000", "0001"}
    assert json.loads(after["run.json"])["settings"]["seed"] == 3
    assert [entry.name for entry in folder.parent.iterdir()] == ["out"]


@pytest.mark.parametrize(
    ("add", "found"),
    [
        (lambda folder: (folder / "notes.txt").write_text("mine"), "notes.txt"),
        (lambda folder: (folder / "maps" / "0001" / "large.png").write_text("mine"), "maps/0001/large.png"),
        (lambda folder: (folder / "maps" / "0001" / "image.png.bak").write_text("mine"), "maps/0001/image.png.bak"),
        (lambda folder: (folder / ".git").mkdir() or (folder / ".git" / "HEAD").write_text("mine"), ".git/HEAD"),
        (lambda folder: (folder / "maps" / "0003").symlink_to(folder.parent), "maps/0003"),
        (lambda folder: (folder / "run.json").unlink(), "no run.json"),
        (lambda folder: (folder / "run.json").write_text("[]"), "run.json of another program"),
        (
            lambda folder: (folder / "run.json").write_text('{"versions": {"numpy": "1"}, "tile_set": {}}'),
            "run.json of a",
        ),
    ],
)
@pytest.mark.parametrize("command", [SMALL, ["pick", "ARCHIVE"]], ids=["generate", "pick"])
def test_a_folder_with_anything_else_is_never_replaced(command, add, found, folder, written, capsys):
    add(folder)
    before = files(folder)
    command = [str(written / "archive.npz") if word == "ARCHIVE" else word for word in command]
    for force in ([], ["--force"]):
        assert main([*command, *force, "--out", str(folder)]) == 2
        said = capsys.readouterr().err
        assert "--force replaces" not in said
    assert f"expected a folder with files of an earlier run alone, got one with {found}" in said
    assert files(folder) == before


def test_pictures_are_replaced_too(folder, tmp_path, capsys):
    command = ["render", str(folder / "maps" / "0000" / "map.json"), "--out", str(tmp_path / "pictures")]
    assert main([*command, "--tile-px", "16", "--overlay"]) == 0
    before = files(tmp_path / "pictures")
    capsys.readouterr()
    assert main([*command, "--tile-px", "32"]) == 2
    assert capsys.readouterr().err.endswith("; --force replaces it\n")
    assert main([*command, "--tile-px", "32", "--force"]) == 0
    after = files(tmp_path / "pictures")
    assert before.keys() - after.keys() == {"overlay.png"}
    assert before["image.png"] != after["image.png"]
    (tmp_path / "pictures" / "labels.png").unlink()
    assert main([*command, "--force"]) == 2
    assert capsys.readouterr().err.endswith("earlier run alone, got one with no labels.png\n")


@pytest.mark.parametrize(
    "options",
    ["--from {}", "--like {}", "--fix {}", "--furnish {}", "--furnish 'signs {}'", "--style s.toml --from {}"],
)
@pytest.mark.parametrize("linked", [True, False])
def test_a_folder_with_a_map_that_a_search_reads_is_not_replaced(options, linked, folder, capsys):
    before, link = files(folder), folder.parent / "link"
    link.symlink_to(folder)
    source = (link if linked else folder) / "maps" / "0001" / "map.json"
    line = [*SMALL, *shlex.split(options.format(source)), "--out", str(folder), "--force"]
    assert main(line) == 2
    assert capsys.readouterr().err.endswith(f"to replace that contains no input, got one with {source}\n")
    assert files(folder) == before


@pytest.mark.parametrize(
    "write",
    [
        lambda file, out: generate(GenerateSpec(search=SearchSpec(initial=[file]), size=(5, 6)), out, force=True),
        lambda file, out: generate(
            GenerateSpec(size=(5, 6)).replace(search=SearchSpec(like=str(file)).replace(method="ea")), out, force=True
        ),
        lambda file, out: generate(GenerateSpec(furnish=f"signs=possible {file}", maps=1), out, force=True),
        lambda file, out: pick(PickSpec(unlike=[file]), [out.parent / "other.npz"], out, force_archive=True),
    ],
    ids=["initial", "like", "furnish", "unlike"],
)
def test_a_folder_with_a_file_that_a_specification_named_is_not_replaced(write, folder):
    before, source = files(folder), folder / "maps" / "0001" / "map.json"
    shutil.copy(folder / "archive.npz", folder.parent / "other.npz")
    with refused(folder, f"one with {source}"):
        write(source, folder)
    assert files(folder) == before


def test_files_for_large_maps_and_those_of_a_style_are_inputs(tmp_path):
    tiles, style, large_style = (tmp_path / name for name in ("tiles.toml", "mine.toml", "large.toml"))
    tiles.write_text("straight = 20\nturn = 10\n")
    style.write_text(f'inventory = "{tiles}"\n')
    large_style.write_text(f'[large]\ninventory = "{tiles}"\n')
    large = {"inventory": str(tiles)}
    for spec in (SearchSpec(large=large), SearchSpec(large=SearchSpec(**large)), SearchSpec().replace(large=large)):
        assert spec.replace(method="ea").inputs == (str(tiles),)
    for file in (style, large_style):
        assert SearchSpec(style=str(file)).inputs == (str(file), str(tiles))


def test_a_word_that_is_also_the_name_of_the_folder_is_no_input(tmp_path, monkeypatch):
    """`--method ea --out ea` names no file, and so the folder can be replaced."""
    monkeypatch.chdir(tmp_path)
    command = [*SMALL, "--maps", "1"]
    assert main([*command, "--out", "ea"]) == 0
    assert main([*command, "--seed", "1", "--out", "ea", "--force"]) == 0
    assert SearchSpec(method="ea", preset="paper", style="paper").inputs == ()
    assert SearchSpec(like="ea/maps/0000/map.json").inputs == ("ea/maps/0000/map.json",)
    assert GenerateSpec(tiles="ea", furnish="signs").inputs == ("ea",)
    shutil.copytree("ea", "archive")
    pick_again = ["pick", "ea/archive.npz", "--maps", "1", "--quiet", "--out", "archive"]
    assert main([*pick_again, "--force-archive", "--force"]) == 0
    assert not Path("archive/archive.npz").exists()


@pytest.mark.parametrize("through", ["folder", "file", "out"])
def test_what_is_read_is_not_replaced_through_a_link_either(through, folder, capsys):
    before, link = files(folder), folder.parent / "link"
    link.symlink_to({"folder": folder, "file": folder / "archive.npz", "out": folder}[through])
    source = {"folder": link / "archive.npz", "file": link, "out": folder / "archive.npz"}[through]
    out = link if through == "out" else folder
    words = f"{out}: expected a folder to replace that contains no input, got one with {source}"
    assert main(["pick", str(source), "--maps", "2", "--out", str(out), "--force-archive"]) == 2
    assert capsys.readouterr().err == f"elitelanes: {words}\n"
    with refused(out, f"one with {source}"):
        pick(PickSpec(maps=2), [source], out, force=True, force_archive=True)
    assert files(folder) == before


def test_a_tile_of_the_set_is_not_replaced(folder, tmp_path, capsys):
    tiles = Path(shutil.copytree(DRAWN, tmp_path / "tiles"))
    tile, road_map = next(path.parent for path in tiles.glob("*/image.png")), folder / "maps" / "0000" / "map.json"
    before = files(tiles)
    assert main(["render", str(road_map), "--tiles", str(tiles), "--out", str(tile), "--force"]) == 2
    assert capsys.readouterr().err.endswith("files of an earlier run alone, got one with no labels.png\n")
    assert files(tiles) == before


def test_pick_replaces_an_archive_only_if_that_is_said(folder, capsys):
    more = Path(shutil.copytree(folder, folder.parent / "more"))
    before = files(more)
    command = ["pick", str(folder / "archive.npz"), "--maps", "2", "--tile-px", "16", "--out", str(more)]
    assert main([*command, "--force"]) == 2
    words = "archive.npz, which pick does not write again; --force-archive replaces it too"
    assert capsys.readouterr().err.endswith(
        f"expected a folder with files of an earlier run alone, got one with {words}\n"
    )
    with refused(more, "one with archive.npz, ...force_archive=True..."):
        pick(PickSpec(maps=2), [folder / "archive.npz"], more, force=True)
    assert files(more) == before
    assert main([*command, "--force-archive"]) == 0
    assert "archive.npz" not in files(more)
    assert main([*command, "--seed", "1", "--force"]) == 0
    assert json.loads((more / "run.json").read_text())["settings"]["seed"] == 1

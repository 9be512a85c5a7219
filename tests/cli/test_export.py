"""The commands ``export`` and ``show``, and what they write beside Duckietown's maps and graphs."""

import csv
import io
import sys
from pathlib import Path

import numpy as np
import pytest

from elitelanes_jax import RoadMap, measure, read_map
from elitelanes_jax.cli.export import _names
from elitelanes_jax.cli.main import main
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.road_map import map_to_json as map_json
from elitelanes_jax.formats.sketch import draw_text
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.formats.sumo import to_sumo
from elitelanes_jax.formats.table import measure_maps, table_to_csv

GRID = np.array([[6, 5, 7, 3], [10, 0, 10, 10], [14, 5, 13, 9], [8, 0, 0, 0]], np.int8)
LOOP = np.array([[6, 3], [12, 9]], np.int8)


@pytest.fixture
def maps(tmp_path):
    files = [tmp_path / "maps" / number / "map.json" for number in ("0000", "0001")]
    for file, grid in zip(files, (LOOP, GRID), strict=True):
        file.parent.mkdir(parents=True)
        file.write_text(map_json(RoadMap(grid)))
    return list(map(str, files))


def test_a_map_in_boxes():
    assert RoadMap(GRID).to_text().splitlines() == ["┌───┬─┐", "│   │ │", "├───┴─┘", "╵"]
    assert RoadMap(GRID).to_text(ascii_only=True).splitlines() == ["+---+-+", "|   | |", "+---+-+", "|"]
    sides = {8: "╵│└├┘┤┴┼", 4: "╶─└┌├┬┴┼", 2: "╷│┌┐├┤┬┼", 1: "╴─┐┘┤┬┴┼"}  # who has a line to the north, and so on
    for code in range(16):
        sign = RoadMap([[code, 0], [0, 0]]).to_text()[:1].strip()
        assert {side for side, signs in sides.items() if sign and sign in signs} == {s for s in sides if code & s}


def test_a_map_one_tile_wide_is_shown_and_written(tmp_path, capsys):
    thin = tmp_path / "thin.yaml"
    thin.write_text("tiles:\n- [straight/E, 4way, straight/E]\n")
    assert main(["show", str(thin)]) == 0
    assert capsys.readouterr().out.splitlines()[:2] == ["  A B C", "1 ──┼───"]
    for to, file in (("duckietown", "again.yaml"), ("csv", "a.csv"), ("sumo", "plain")):
        assert main(["export", str(thin), "--to", to, "--out", str(tmp_path / file)]) == 0
    assert read_map(tmp_path / "again.yaml").codes.tolist() == [[5, 15, 5]]
    assert main(["render", str(thin), "--tile-px", "16", "--out", str(tmp_path / "picture")]) == 0


def test_a_table_is_what_measure_says():
    rows = measure_maps(["a", "b", "c"], [GRID, LOOP, GRID.T])
    for row, (name, grid) in zip(rows, (("a", GRID), ("b", LOOP), ("c", GRID.T)), strict=True):
        figures = {field: value.item() for field, value in measure(grid)._asdict().items()}
        assert row == {"file": name, "height": grid.shape[0], "width": grid.shape[1]} | figures
        assert next(iter(row)) == "file"
    (row,) = measure_maps(["a"], [np.where(np.arange(81).reshape(9, 9) < 44, 15, 0)])
    assert row["coverage"] == 0.54320985 and np.float32(row["coverage"]) == np.float32(44 / 81)
    assert ",0.54320985\n" in table_to_csv([row])
    lines = list(csv.DictReader(table_to_csv(rows).splitlines()))
    assert [{key: str(value) for key, value in row.items()} for row in rows] == lines


def test_a_file_for_each_map(maps, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["export", *maps, "--to", "duckietown", "--dead-ends", "grass", "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"2 maps in {out}\n1 of 16 tiles left out: roads that lead nowhere\n"
    assert sorted(file.name for file in out.iterdir()) == ["0000.yaml", "0001.yaml"]
    assert read_map(out / "0001.yaml").codes.tolist() == [[6, 5, 7, 3], [10, 0, 10, 10], [12, 5, 13, 9], [0] * 4]
    again = tmp_path / "again"
    assert main(["export", *map(str, sorted(out.iterdir())), "--to", "opendrive", "--out", str(again)]) == 0
    assert sorted(file.name for file in again.iterdir()) == ["0000.xodr", "0001.xodr"]


def test_sumo_has_four_files_for_each_map(maps, tmp_path):
    out = tmp_path / "out"
    options = ["--tile-size", "0.585", "--lane", "0.222", "--speed", "0.3", "--right-of-way", "right_before_left"]
    assert main(["export", *maps, "--to", "sumo", *options, "--out", str(out)]) == 0
    kinds = ("nod.xml", "edg.xml", "con.xml", "netccfg")
    assert sorted(file.name for file in out.iterdir()) == sorted(
        f"{number}.{kind}" for number in ("0000", "0001") for kind in kinds
    )
    texts = tuple((out / f"0001.{kind}").read_text() for kind in kinds)
    assert texts == to_sumo(as_map(GRID), "0001", Streets(0.585, 0.222, 0.3, "right_before_left"))


@pytest.mark.parametrize(
    ("files", "written"),
    [
        ("a.json b/c.json", "a c"),
        ("a.json maps/0/map.json maps/1/map.json", "0 1 a"),
        ("a/maps/0/map.json b/maps/0/map.json b/maps/1/map.json", "a-maps-0 b-maps-0 b-maps-1"),
        ("a.json a/a.json", "a-a TOP-a"),
        # Some file systems ignore case, or how an accent is encoded.
        ("x/Town.json y/town.json", "x-Town y-town"),
        ("x/stra\u00dfe.json y/STRASSE.json", "x-stra\u00dfe y-STRASSE"),
        ("x/z\u00fcrich.json y/zu\u0308rich.json", "x-z\u00fcrich y-zu\u0308rich"),
        ("x/T/0/map.json y/t/0/map.json z/u/0/map.json", "x-T-0 y-t-0 z-u-0"),
    ],
)
def test_names_have_the_folders_that_tell_maps_apart(files, written, tmp_path, monkeypatch):
    top = tmp_path / "TOP"
    top.mkdir()
    monkeypatch.chdir(top)
    for file in files.split():
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        RoadMap(GRID).save(file)
    assert main(["export", *files.split(), "--to", "opendrive", "--out", "out"]) == 0
    assert sorted(file.stem for file in Path("out").iterdir()) == sorted(written.split())


def test_a_map_at_the_root_has_the_name_of_its_file():
    """Its folder has no name, which ended in a StopIteration."""
    file = Path(Path.cwd().anchor, "map.json")
    assert _names([file]) == {file: "map"}


def test_what_cannot_be_done_is_said_in_one_line(maps, tmp_path, capsys):
    out = str(tmp_path / "out")
    same, strange = (str(tmp_path / "maps" / name) for name in ("0000.json", "a\nmap.json"))
    Path(same).write_text('{"codes": [[6, 3], [12, 9]]}')
    Path(strange).write_text('{"codes": [[4, 1], [0, 0]]}')
    alike = [str(tmp_path / "maps" / name) for name in ("town.json", "Town.json")]
    for file in alike:
        RoadMap(LOOP).save(file)
    for options, message in (
        ([*maps, "--to", "sumo", "--out", out + ".Nod.xml"], "--out: expected a folder, got "),
        (
            [*maps, same, "--to", "movingai"],
            f"expected maps of different names, got two for 0000; the other is {maps[0]}",
        ),
        (
            [*alike, "--to", "usd"],
            f"{alike[1]}: expected maps of different names, got two for Town on file systems that ignore case; "
            f"the other is {alike[0]}",
        ),
        ([maps[0], strange, "--to", "duckietown"], r"a\nmap.json: grid: expected tiles with two or more"),
    ):
        assert main(["export", "--out", out, *options]) == 2
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1
        assert {file.name for file in tmp_path.iterdir()} == {"maps"}


def test_show(maps, tmp_path, capsys):
    assert main(["show", maps[1]]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:6] == ["  A B C D", "1 ┌───┬─┐", "2 │   │ │", "3 ├───┴─┘", "4 ╵", ""]
    assert lines[6].startswith("4 x 4 tiles, components 1, cyclomatic 2, dead ends 1, ")
    assert max(map(len, lines)) <= 100
    (tmp_path / "map.yaml").write_text("tiles:\n- [curve_left/W, curve_left/N]\n- [curve_left/S, curve_left/E]\n")
    assert main(["show", str(tmp_path / "map.yaml")]) == 0
    assert capsys.readouterr().out.startswith("  A B\n1 ┌─┐\n2 └─┘\n\n2 x 2 tiles")
    assert main(["render", str(tmp_path / "map.yaml"), "--tile-px", "16"]) == 0
    assert (tmp_path / "map" / "image.png").exists()


def test_wide_maps_have_the_name_of_every_second_column():
    codes = np.tile(np.array([[6, 3], [12, 9]], np.int8), (5, 14))
    head, *lines = draw_text(codes, named=True).splitlines()
    plain = draw_text(codes).splitlines()
    assert lines == [f"{row:2} {line}" for row, line in enumerate(plain, 1)]
    assert head.split() == [*"ACEGIKMOQSUWY", "AA"]
    # Each name is above its column. The numbers of rows take three characters.
    assert [head.index(name) for name in ("A", "C", "AA")] == [3, 3 + 2 * 2, 3 + 2 * 26]


def test_a_terminal_without_box_drawing(maps, monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    assert main(["show", maps[0]]) == 0
    assert stream.buffer.getvalue().startswith(b"  A B\n1 +-+\n2 +-+\n\n2 x 2 tiles")


def test_a_dataset_is_refused_with_the_command_that_reads_it(tmp_path, capsys):
    (tmp_path / "lanes").mkdir()
    (tmp_path / "lanes" / "dataset.json").write_text("{}")
    assert main(["export", str(tmp_path / "lanes"), "--to", "sumo", "--out", str(tmp_path / "out")]) == 2
    assert "got a dataset; elitelanes pack exports its maps" in capsys.readouterr().err


@pytest.mark.parametrize("target", ["csv", "opendrive"])
def test_a_map_that_is_given_twice_is_written_once(target, maps, tmp_path, capsys):
    same = Path(maps[0])
    again = str(same.parent / ".." / same.parent.name / same.name)
    out = tmp_path / ("out.csv" if target == "csv" else "out")
    assert main(["export", maps[0], again, "--to", target, "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"1 map in {out}\n"
    assert len(out.read_text().splitlines()) == 2 if target == "csv" else len([*out.iterdir()]) == 1

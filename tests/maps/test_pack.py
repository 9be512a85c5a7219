"""Packs: every file is listed, splits share no niche, trips are shortest, and a resumed pack has the same bytes."""

import csv
import json
import pickle
import shutil
from hashlib import sha256

import networkx as nx
import numpy as np
import pytest
from folders import files
from refusals import refused

from elitelanes_jax import DatasetSpec, RoadMap, make_dataset, mirror, read_map, rotate
from elitelanes_jax.cli.main import main
from elitelanes_jax.drive import movements
from elitelanes_jax.drive.lanes import lane_length
from elitelanes_jax.lanes.movements import Movement, lane_graph
from elitelanes_jax.maps import PackSpec, exporting, furnish, given, pack, packing
from elitelanes_jax.maps.exporting import FormatOptions
from elitelanes_jax.maps.given import parse_given
from elitelanes_jax.maps.packing import _announce_limits, _split, _trips
from elitelanes_jax.network import plain_measure, wfc
from elitelanes_jax.tiles.tileset import default_tiles

GRIDS = wfc.generate_batch(np.random.default_rng(0), 16, (6, 7), border="closed").grid
MAPS = [
    RoadMap(grid, metrics=plain_measure(grid), niche=[number % 8, number // 12]) for number, grid in enumerate(GRIDS)
]
SPEC = PackSpec(to=("movingai", "duckietown"), trips=5)


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("packs") / "pack"
    pack(SPEC, MAPS, folder)
    return folder


def rows(file):
    with file.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_checksums_are_those_of_all_files(packed):
    listed = dict(line.split("  ")[::-1] for line in (packed / "SHA256SUMS").read_text().splitlines())
    found = {name: sha256(content).hexdigest() for name, content in files(packed).items()}
    found.pop("SHA256SUMS")
    assert listed == found


def test_every_map_is_in_its_niche_in_all_formats(packed):
    table = rows(packed / "maps.csv")
    assert len({row["id"] for row in table}) == len(MAPS)
    for row, road_map in zip(table, MAPS, strict=True):
        assert row["niche"] == "6x7-{:02d}-{:02d}".format(*road_map.niche)
        place = f"{row['niche']}/{row['id']}"
        assert read_map(packed / "maps" / f"{place}.json") == road_map
        assert (read_map(packed / "duckietown" / f"{place}.yaml").codes == road_map.codes).all()
        scen = (packed / "movingai" / f"{place}.scen").read_text()
        assert f"\t{row['id']}.map\t" in scen and (packed / "movingai" / f"{place}.map").is_file()


def test_the_table_has_the_shortest_decimals(packed):
    for row, grid in zip(rows(packed / "maps.csv"), GRIDS, strict=True):
        assert row["coverage"] == str(np.float32((grid > 0).mean()))


@pytest.mark.parametrize("split", [(0.8, 0.1, 0.1), (0.5, 0.5, 0), (1, 0, 0), (0.98, 0.01, 0.01)])
def test_splits_hold_out_whole_niches(split, tmp_path):
    about = pack(SPEC.replace(to=(), split=split), MAPS, tmp_path / "pack")
    table = {row["id"]: row for row in rows(tmp_path / "pack" / "maps.csv")}
    parts = {
        name: (tmp_path / "pack" / "splits" / f"{name}.txt").read_text().split()
        for name in ("train", "validation", "test")
    }
    assert sorted(one for ids in parts.values() for one in ids) == sorted(table)
    niches = {name: {table[one]["niche"] for one in ids} for name, ids in parts.items()}
    assert sum(map(len, niches.values())) == len(set.union(*niches.values()))
    for (name, ids), share in zip(parts.items(), split, strict=True):
        assert all(table[one]["split"] == name for one in ids)
        assert bool(ids) == bool(share) and abs(len(ids) - share * len(MAPS)) <= 3
        assert about["splits"].get(name, {"maps": 0})["maps"] == len(ids)


def test_an_index_has_the_scenarios_of_its_split(tmp_path):
    spec = SPEC.replace(to=("scenarionet",), trips=1, split=(0.5, 0.5, 0))
    pack(spec, MAPS[:6], tmp_path / "pack")
    folder = tmp_path / "pack" / "scenarionet"
    assert not (folder / "test").exists()
    card = (tmp_path / "pack" / "README.md").read_text()
    listed = set()
    for split in ("train", "validation"):
        assert f"| `scenarionet/{split}` |" in card
        mapping = pickle.loads((folder / split / "dataset_mapping.pkl").read_bytes())
        ids = (tmp_path / "pack" / "splits" / f"{split}.txt").read_text().split()
        assert list(mapping) == [f"sd_{town}.pkl" for town in ids]
        listed |= {(folder / split / place / name).resolve() for name, place in mapping.items()}
    assert listed == {file.resolve() for file in folder.rglob("sd_*.pkl")}


def test_a_large_niche_counts_with_all_its_maps():
    """Half of the maps are in one niche, which is drawn early: they fill one half, and all others the other one."""
    maps = [RoadMap(grid, niche=[max(number - 7, 0)]) for number, grid in enumerate(GRIDS)]
    packed = _split(SPEC.replace(split=(0.5, 0.5, 0), seed=3), maps)
    (large,) = {one.split for one in packed[:8]}
    assert [one.split for one in packed].count(large) <= 9, "one is drawn before it"


def test_another_seed_gives_other_splits_and_trips():
    one, other = (_split(SPEC.replace(seed=seed), MAPS) for seed in (0, 1))
    assert [each.id for each in one] == [each.id for each in other]
    assert [each.split for each in one] != [each.split for each in other]
    graph = lane_graph(GRIDS[0])
    assert _trips(SPEC, one[0], graph) != _trips(SPEC.replace(seed=1), one[0], graph)


def test_no_trip_ends_where_it_starts():
    (ring,) = _split(SPEC.replace(split=(1, 0, 0)), [RoadMap(np.array([[6, 3], [12, 9]]))])
    trips = _trips(SPEC.replace(trips=50), ring, lane_graph(ring.road_map.codes))
    assert len(trips) == 50 and min(trip["length"] for trip in trips) > 0


def test_trips_are_as_long_as_shortest_ways(packed):
    for row, grid in list(zip(rows(packed / "maps.csv"), GRIDS, strict=True))[:4]:
        every = Movement(*np.argwhere(np.asarray(movements(grid))).T.astype(np.int32))
        graph = nx.DiGraph()
        nodes, after = (np.stack(node, axis=-1).tolist() for node in (every.node, every.next_node))
        for start, goal, length in zip(nodes, after, lane_length(every.turn).tolist(), strict=True):
            graph.add_edge(tuple(start), tuple(goal), length=length)
        trips = rows(packed / "trips" / row["niche"] / f"{row['id']}.csv")
        assert len(trips) == 5
        for trip in trips:
            start, goal = (
                tuple(int(trip[f"{end}_{name}"]) for name in ("row", "column", "heading")) for end in ("start", "goal")
            )
            expected = nx.dijkstra_path_length(graph, start, goal, weight="length")
            assert start != goal and float(trip["length"]) == pytest.approx(expected, abs=1e-4)


STUB = [[6, 5, 7, 5, 3], [10, 0, 8, 0, 10], [10, 0, 0, 0, 10], [12, 5, 5, 5, 9]]
"""A ring with a crossing, from which a road leads nowhere."""


def test_no_trip_leads_to_a_road_that_the_format_lacks(tmp_path):
    spec = PackSpec(to=("duckietown",), split=(1, 0, 0), trips=200, formats=FormatOptions(dead_ends="grass"))
    pack(spec, [RoadMap(STUB)], tmp_path / "pack")
    town = read_map(next((tmp_path / "pack" / "duckietown").rglob("*.yaml"))).codes
    for trip in rows(next((tmp_path / "pack" / "trips").rglob("*.csv"))):
        for end in ("start", "goal"):
            assert town[int(trip[f"{end}_row"]), int(trip[f"{end}_column"])] > 0


def test_signs_of_a_crossing_that_is_removed_are_named(tmp_path, capsys):
    signed = furnish(RoadMap(STUB), "signs=possible")
    file, count = tmp_path / "signed.json", len(signed.objects)
    signed.save(file)
    options = ["--split", "1", "0", "0", "--to", "duckietown", "--dead-ends", "grass", "--out", str(tmp_path / "pack")]
    assert main(["pack", str(file), *options]) == 0
    assert f"signed.json: {count} of {count} signs do not fit the roads" in capsys.readouterr().err


def test_the_first_map_with_a_part_that_a_program_cannot_use_is_named(monkeypatch):
    said, crossing = [], np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]])
    monkeypatch.setattr("elitelanes_jax.maps.packing.announce_at_end", lambda *words: said.append(words))
    maps = [RoadMap(codes) for codes in ([[6, 3], [12, 9]], crossing, np.pad(crossing, 1))]
    _announce_limits(PackSpec(to=("duckiematrix", "sumo")), maps, None)
    ((to, words),) = said
    assert to == "duckiematrix" and words.startswith("2 of 3 maps, the first: ") and "at B2 ([1, 1]);" in words


def test_trips_follow_the_lanes_of_the_tile_set(tmp_path):
    """On a ring with the lanes 0.4 tile beside the middle the way inside is 0.1 tile from the corner."""
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    with (tmp_path / "tiles" / "tileset.toml").open("a") as file:
        file.write("lane_offset = 0.4\n")
    spec = PackSpec(
        to=("mujoco",), trips=3, split=(1, 0, 0), formats=FormatOptions(tiles=tmp_path / "tiles", tile_px=16)
    )
    pack(spec, [RoadMap(np.array([[6, 3], [12, 9]]))], tmp_path / "pack")
    (file,) = (tmp_path / "pack" / "trips").rglob("*.csv")
    for trip in rows(file):
        quarters = float(trip["length"]) / (np.pi / 2)
        assert min(abs(quarters - tiles * radius) for tiles in (1, 2, 3) for radius in (0.1, 0.9)) < 1e-6
    assert "0.4 tile right of the middle of the road" in (tmp_path / "pack" / "README.md").read_text()


def test_the_same_maps_give_the_same_bytes_after_an_interruption_too(packed, tmp_path, monkeypatch):
    expected, drawn = files(packed), []
    usual = exporting.FORMATS["duckietown"]

    def interrupt(road_map, name, **settings):
        drawn.append(name)
        if len(drawn) == 9:
            raise KeyboardInterrupt
        return usual.convert(road_map, name, **settings)

    monkeypatch.setitem(exporting.FORMATS, "duckietown", usual._replace(convert=interrupt))
    with pytest.raises(KeyboardInterrupt):
        pack(SPEC, MAPS, tmp_path / "pack")
    assert not (tmp_path / "pack").exists()
    pack(SPEC, MAPS, tmp_path / "pack")
    assert files(tmp_path / "pack") == expected
    assert len(drawn) == len(MAPS) + 3  # a map for the check of the settings, twice, and the interrupted one again


@pytest.mark.parametrize("damage", ["cut", "empty", "zero", "journal"])
def test_damaged_files_are_written_again(damage, packed, tmp_path, monkeypatch):
    """After a loss of power, the last files of a run may be cut off, empty or zero."""
    with monkeypatch.context() as patch:

        def interrupt(*_):
            raise KeyboardInterrupt

        patch.setattr(packing, "write_sums", interrupt)
        with pytest.raises(KeyboardInterrupt):
            pack(SPEC, MAPS, tmp_path / "pack")
    unfinished = tmp_path / ".pack-unfinished"
    if damage == "journal":
        damaged = [unfinished / "kept" / "files.jsonl"]
    else:
        damaged = [file for file in (unfinished / "files").rglob("*") if file.is_file()]
    for file in damaged:
        content = file.read_bytes()
        kept = {"empty": b"", "zero": bytes(len(content))}.get(damage, content[: len(content) // 2])
        file.write_bytes(kept)
    pack(SPEC, MAPS, tmp_path / "pack")
    assert files(tmp_path / "pack") == files(packed)


def test_all_maps_of_a_pack_have_the_same_tiles(tmp_path, monkeypatch):
    """A pack is not resumed with other tiles, and tiles that changed between two packs are read again."""
    tiles = shutil.copytree(default_tiles(), tmp_path / "tiles")
    spec = PackSpec(to=("mujoco",), trips=3, split=(1, 0, 0), formats=FormatOptions(tiles=tiles, tile_px=16))
    usual = packing._write

    def interrupt(spec, town, folder, *others):
        row = usual(spec, town, folder, *others)
        if town.road_map is MAPS[3]:
            raise KeyboardInterrupt
        return row

    monkeypatch.setattr(packing, "_write", interrupt)
    with pytest.raises(KeyboardInterrupt):
        pack(spec, MAPS[:6], tmp_path / "pack")
    monkeypatch.undo()
    with (tiles / "tileset.toml").open("a") as file:
        file.write("lane_offset = 0.4\n")
    with refused(tmp_path / "pack", "results with None", expected="tile_set lane_offset 0.4"):
        pack(spec, MAPS[:6], tmp_path / "pack")
    pack(spec, MAPS[:6], tmp_path / "another")
    assert "0.4 tile right of the middle of the road" in (tmp_path / "another" / "README.md").read_text()


def test_an_id_is_that_of_all_rotations_and_mirror_images(packed, tmp_path):
    turned = [RoadMap(mirror(rotate(one.codes, number)), niche=one.niche) for number, one in enumerate(MAPS)]
    pack(SPEC, [*turned, *MAPS], tmp_path / "pack")
    ids = [[row["id"] for row in rows(folder / "maps.csv")] for folder in (packed, tmp_path / "pack")]
    assert ids[0] == ids[1]


def test_a_dataset_is_packed_as_its_maps_are(tmp_path):
    spec = DatasetSpec(maps_from=MAPS, tile_px=16, views=2)
    make_dataset(spec, tmp_path / "dataset")
    # A user may keep other files in the folder, such as predictions.
    (tmp_path / "dataset" / "found.jsonl").write_text('{"number": 0, "d": 0.02, "phi": -0.1}\n')
    assert parse_given(tmp_path / "dataset").left_out == 0
    pack(SPEC, tmp_path / "dataset", tmp_path / "pack")
    packed = rows(tmp_path / "pack" / "maps.csv")
    assert [row["niche"] for row in packed] == ["6x7-{:02d}-{:02d}".format(*one.niche) for one in MAPS]
    (tmp_path / "dataset" / "train" / "metadata.jsonl").write_text('{"codes": 3}\n')
    with refused(tmp_path / "dataset/train/metadata.jsonl", '{"codes": 3}'):
        pack(SPEC, tmp_path / "dataset", tmp_path / "other")


def test_a_part_of_a_dataset_is_refused_as_such(tmp_path):
    spec = DatasetSpec(maps_from=MAPS[:2], split=(1, 0, 0), tile_px=16, part=(1, 2))
    make_dataset(spec, tmp_path / "part")
    with refused(tmp_path / "part", "a part"):
        parse_given(tmp_path / "part")


def test_what_is_not_read_in_a_folder_is_named(packed, tmp_path, capsys):
    given, codes = tmp_path / "given", RoadMap([[6, 3], [12, 9]])
    (given / "town").mkdir(parents=True)
    (given / ".hidden").mkdir()
    (given / "pictures").mkdir()
    codes.save(given / "town" / "map.json")
    options = ["--split", "1", "0", "0", "--trips", "1", "--out"]
    assert main(["pack", str(given), *options, str(tmp_path / "one")]) == 0
    assert "not read" not in capsys.readouterr().err
    RoadMap([[6, 7, 3], [12, 13, 9]]).save(given / "beside.json")
    RoadMap([[6, 7, 3], [12, 13, 9]]).save(given / ".hidden" / "beside.json")
    shutil.copytree(packed, given / "packed")
    assert main(["pack", str(given), *options, str(tmp_path / "two")]) == 0
    assert f"{given}: not read: beside.json, packed; name each, to use its maps too" in capsys.readouterr().err


def test_a_folder_that_may_not_be_read_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "town").mkdir()
    (tmp_path / "locked").mkdir()
    RoadMap([[6, 3], [12, 9]]).save(tmp_path / "town" / "map.json")
    is_layers = given.is_layers

    def refused(folder):
        if folder.name == "locked":
            raise PermissionError
        return is_layers(folder)

    monkeypatch.setattr(given, "is_layers", refused)
    assert len(parse_given(tmp_path).maps) == 1


def test_a_pack_is_replaced_only_by_force_and_alone(tmp_path):
    out, spec = tmp_path / "pack", SPEC.replace(to=())
    pack(spec, MAPS, out)
    with refused(tmp_path / "pack", "one with files in it"):
        pack(spec, MAPS[:8], out)
    pack(spec, MAPS[:8], out, force=True)
    assert json.loads((out / "pack.json").read_text())["maps"]["number"] == 8
    (out / "mine.txt").write_text("mine")
    with refused(tmp_path / "pack", "one with mine.txt"):
        pack(spec, MAPS, out, force=True)


def test_what_cannot_be_packed_is_refused_before_anything_is_written(tmp_path):
    stub = RoadMap(np.array([[4, 1], [0, 0]]), niche=[0])
    for spec, maps, subject, got, expected in (
        (SPEC, [], "sources", "none", "at least one map"),
        (SPEC, MAPS[:2], "split", "2 in all", ""),
        (SPEC.replace(split=(1, 0, 0)), [*MAPS, stub], "niche 2x2-00, map 16: grid", "none", "lane"),
    ):
        with refused(subject, got, expected):
            pack(spec, maps, tmp_path / "pack")
        assert not (tmp_path / "pack").exists()


def test_a_pack_is_not_replaced_by_one_of_its_own_maps(packed):
    before = files(packed)
    file = next(packed.glob("maps/*/*.json"))
    with refused(packed, f"one with {file}"):
        pack(PackSpec(split=(1, 0, 0)), [file], packed, force=True)
    assert files(packed) == before


def test_the_maps_of_a_pack_are_read(packed):
    assert {one.codes.tobytes() for one in parse_given(packed).maps} == {one.codes.tobytes() for one in MAPS}


def test_features_with_the_names_of_columns_do_not_replace_them(tmp_path):
    loop = RoadMap([[6, 3], [12, 9]], metrics={"split": 7, "trip": -1, "mean_block": 2.5})
    pack(PackSpec(split=(1, 0, 0), trips=2), [loop], tmp_path / "pack")
    (row,) = rows(tmp_path / "pack" / "maps.csv")
    assert row["split"] == "train"
    assert float(row["trip"]) > 0
    assert row["mean_block"] == "2.5"

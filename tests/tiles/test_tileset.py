"""Tile sets: the drawn one, the photographed one, and all that can be wrong with a folder."""

import os
import shutil
import struct
import zlib

import cv2
import numpy as np
import pytest

from elitelanes_jax.network.codes import CONNECTIONS, ROAD_ALPHABET
from elitelanes_jax.tiles.tileset import default_tiles, describe_tiles, inspect_tiles, load_tiles


@pytest.fixture
def folder(tmp_path):
    """A copy of the default set that may be spoilt."""
    copy = tmp_path / "tiles"
    shutil.copytree(default_tiles(), copy, ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    return copy


def test_the_drawn_set(drawn_tiles):
    kinds = [tile.name.rpartition("_")[0] for tile in drawn_tiles.tiles]
    assert kinds == ["turn"] * 4 + ["straight"] * 4 + ["crossing3"] * 3 + ["crossing4"] + ["end"] * 2
    assert drawn_tiles.alphabet == ROAD_ALPHABET
    assert drawn_tiles.licence == "Apache-2.0"
    assert min(tile.image.shape[0] for tile in drawn_tiles.tiles) >= 256
    counts = {code: len(draws) for code, draws in drawn_tiles.rotations.items()}
    # An empty cell is bare ground, which looks the same from all sides.
    by_connections = {1: 2, 2: 4, 3: 3, 4: 4}
    assert counts == {code: by_connections[int(CONNECTIONS[code])] for code in range(1, 16)} | {5: 8, 10: 8, 0: 4}


def test_the_photographed_set(real_tiles):
    assert [tile.name for tile in real_tiles.tiles] == ["turn_1", "straight_1", "crossing3_1", "crossing4_1"]
    assert real_tiles.alphabet == ROAD_ALPHABET
    assert real_tiles.name == "real_tiles"


def test_a_description(drawn_tiles):
    text = describe_tiles(drawn_tiles)
    assert "Elite Lanes drawn tiles: 14 tiles, licence Apache-2.0" in text
    assert "crossing3_2  opens NSW   384 x 384 pixels" in text
    assert "56 pictures of the codes 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15" in text


def test_sides_may_be_stated(folder):
    for file in (folder / "turn_2").iterdir():
        picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(file), np.ascontiguousarray(np.rot90(picture)))
    (folder / "tileset.toml").write_text('[opens]\nturn_2 = "SE"\n')
    tiles = load_tiles(folder)
    assert tiles.name == "tiles"
    assert tiles.licence == ""
    assert [tile.code for tile in tiles.tiles[:3]] == [3, 6, 3]


def test_a_set_may_lack_the_four_way_crossing(folder):
    shutil.rmtree(folder / "crossing4_1")
    assert load_tiles(folder).alphabet == ROAD_ALPHABET[:-1]


def test_a_set_may_lack_ends(folder):
    for number in (1, 2):
        shutil.rmtree(folder / f"end_{number}")
    tiles = load_tiles(folder)
    assert tiles.alphabet == ROAD_ALPHABET
    assert "no end: maps with dead ends cannot be drawn" in describe_tiles(tiles)


def test_numbers_are_sorted_as_numbers(folder):
    shutil.copytree(folder / "turn_1", folder / "turn_10")
    assert [tile.name for tile in load_tiles(folder).tiles][:5] == ["turn_1", "turn_2", "turn_3", "turn_4", "turn_10"]


def test_masks_of_zeros_and_ones_and_grey_pictures_are_fine(folder):
    mask = cv2.imread(str(folder / "turn_1" / "road.png"), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(folder / "turn_1" / "road.png"), mask // 255)
    cv2.imwrite(str(folder / "turn_1" / "image.png"), mask)
    tile = load_tiles(folder).tiles[0]
    np.testing.assert_array_equal(tile.road, mask > 0)
    np.testing.assert_array_equal(tile.image[..., 2], mask)


def write(folder, name, picture):
    cv2.imwrite(str(folder / name), picture)


def test_masks_and_points_of_ones_own(folder):
    cones = np.zeros((384, 384), np.uint8)
    cones[3:9, 5:7] = 255
    write(folder, "turn_1/cones.png", cones)
    write(folder, "turn_2/wet_floor.png", cones // 255)
    (folder / "turn_1" / "._cones.png").write_bytes(b"what a file manager left")
    (folder / "straight_3" / "points.json").write_text('{"cones": [[0, 384], [12.5, 7]], "none": []}')
    tiles = load_tiles(folder)
    assert tiles.layers == ("cones", "wet_floor")
    assert tiles.points == ("cones", "none")
    np.testing.assert_array_equal(tiles.tiles[0].layers["cones"], cones > 0)
    assert [sorted(tile.layers) for tile in tiles.tiles[:3]] == [["cones"], ["wet_floor"], []]
    points = tiles.tiles[6].points
    assert points["cones"].tolist() == [[0, 384], [12.5, 7]]
    assert points["none"].shape == (0, 2)
    assert describe_tiles(tiles).endswith("layers: cones, wet_floor\npoints: cones, none")


def clear(folder, part):
    mask = cv2.imread(str(folder / "straight_1" / "road.png"), cv2.IMREAD_GRAYSCALE)
    mask[part] = 0
    write(folder, "straight_1/road.png", mask)


def sparse(name):
    """A file of 20 GB without a single block on the disk."""

    def spoil(folder):
        (folder / name).touch()
        os.truncate(folder / name, 20 * 2**30)

    return spoil


def toml(text):
    return lambda folder: (folder / "tileset.toml").write_text(text)


def points(text):
    return lambda folder: (folder / "turn_1" / "points.json").write_text(text)


def drawn(name, picture):
    return lambda folder: write(folder, name, picture)


def image(content):
    """Bytes, or a function from those that were there, in place of a tile's picture."""

    def spoil(folder):
        file = folder / "turn_1" / "image.png"
        file.write_bytes(content if isinstance(content, bytes) else content(file.read_bytes()))

    return spoil


def without(pattern):
    return lambda folder: [shutil.rmtree(place) for place in folder.glob(pattern)]


def png(width, height, rows, cut=False):
    """A PNG file of a grey picture, chunk by chunk."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packed = zlib.compress(rows)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
        + chunk(b"IDAT", packed[:-6] if cut else packed)
        + chunk(b"IEND", b"")
    )


UNREADABLE = "turn_1/image.png: expected a PNG picture of 8 bits a channel, got one that cannot be read"
SPOILS = [
    (
        lambda folder: (folder / "turn_2" / "red.png").unlink(),
        r"turn_2: expected image.png, road.png, red.png and yellow.png, got no red.png",
    ),
    (
        drawn("straight_1/road.png", np.zeros((100, 90), np.uint8)),
        r"straight_1/road.png: expected 384 x 384 pixels like image.png, got 90 x 100",
    ),
    (
        drawn("turn_1/yellow.png", np.full((384, 384), [[0, 7, 9] * 128], np.uint8)),
        r"turn_1/yellow.png: expected a mask of two values, 0 and one other, got 3: 0, 7, 9",
    ),
    (
        drawn("turn_1/yellow.png", np.full((384, 384), [[1, 255] * 192], np.uint8)),
        r"turn_1/yellow.png: expected a mask of two values, 0 and one other, got 2: 1, 255",
    ),
    (
        drawn("turn_1/red.png", np.full((384, 384, 3), [0, 0, 255], np.uint8)),
        r"turn_1/red.png: expected a grey mask, got one in colours",
    ),
    (
        lambda folder: (folder / "crossing4_1" / "image.png").write_bytes(b"no picture"),
        r"crossing4_1/image.png: expected a PNG picture of 8 bits a channel, got one that cannot be read",
    ),
    (image(lambda before: before[:9000]), UNREADABLE),
    (image(lambda before: before.replace(b"\x55", b"\x56")), UNREADABLE),
    (image(b""), UNREADABLE),
    (
        drawn("turn_1/image.png", np.zeros((384, 384, 3), np.uint16)),
        r"turn_1/image.png: expected a PNG picture of 8 bits a channel, got uint16",
    ),
    (
        drawn("turn_1/image.png", np.zeros((384, 300, 3), np.uint8)),
        r"turn_1/image.png: expected a square picture, got 300 x 384 pixels",
    ),
    (without("crossing*"), r"expected tiles of every kind a map needs .*, got no crossing"),
    (without("straight*"), r"expected tiles of every kind a map needs .*, got no straight"),
    (without("*_*"), r"got no straight and no turn and no crossing"),
    (
        lambda folder: (folder / "turn_1").rename(folder / "trun_1"),
        r"trun_1: expected a folder <kind>_<number>, the kind one of turn, straight, crossing3, crossing4, end",
    ),
    (toml("name ="), r"tileset.toml: expected a readable TOML file, got: "),
    (toml("name = " + "[" * 10_000), r"tileset.toml: expected a readable TOML file, got: "),
    (toml("name = " + "9" * 10_000), r"tileset.toml: expected a readable TOML file, got: Exceeds the limit"),
    (toml("name" + ".a" * 5_000 + " = 1"), r"tileset.toml: expected name to be text, got {'a': {'a': .{0,80}$"),
    (sparse("tileset.toml"), r"tileset.toml: expected a file of at most 64 KiB, got a larger one"),
    (sparse("turn_1/image.png"), r"turn_1/image.png: expected a file of at most 72 MiB, got a larger one"),
    (sparse("turn_1/points.json"), r"turn_1/points.json: expected a file of at most 8 MiB, got a larger one"),
    (toml("name = 3"), r"tileset.toml: expected name to be text, got 3"),
    (toml("opens = 3"), r"tileset.toml: expected a table \[opens\], got 3"),
    (toml('[opens]\nturn_9 = "SW"'), r"tileset.toml: \[opens\]: expected a tile of the set, got 'turn_9'"),
    (
        toml("[opens]\nturn_1 = true\nturn = 5"),
        r"tileset.toml: expected turn_1 to open 2 sides that meet, as letters of NESW, got True",
    ),
    (toml('license = "MIT"'), r"tileset.toml: expected the keys name, licence, blend, opens, got 'license'"),
    (toml('blend = "off"'), "tileset.toml: expected blend to be true or false, got 'off'"),
    (
        lambda folder: (
            [(folder / "turn_1" / f"{name}.png").unlink() for name in ("image", "red")],
            (folder / "turn_1").rename(folder / "Turn_1"),
        ),
        r"Turn_1: expected a folder <kind>_<number>",
    ),
    (image(png(0, 0, b"")), UNREADABLE),
    (image(png(60_000, 60_000, b"\0" * 99)), UNREADABLE + ": it has 60000 x 60000 pixels, not 1 to 4096 a side"),
    (image(png(8, 8, b"\0" * 71)), UNREADABLE + ": it is damaged or unfinished"),
    (image(png(8, 8, b"\0" * 10**6)), UNREADABLE + ": it is damaged or unfinished"),
    (image(png(8, 8, b"\0" * 99, cut=True)), UNREADABLE),
    (
        drawn("turn_1/cones.png", np.zeros((100, 90), np.uint8)),
        r"turn_1/cones.png: expected 384 x 384 pixels like image.png, got 90 x 100",
    ),
    (
        drawn("turn_1/labels.png", np.zeros((384, 384), np.uint8)),
        r"turn_1/labels.png: expected a mask's name in small letters, .* none of labels, overlay, instances, got "
        "'labels'",
    ),
    (
        drawn("turn_1/Road.png", np.zeros((384, 384), np.uint8)),
        r"turn_1/Road.png: expected a mask's name in small letters, .*, got 'Road'",
    ),
    (points("{"), r"turn_1/points.json: expected a readable JSON file, got: "),
    (points("[[1, 2]]"), r'turn_1/points.json: expected points by name, {"name": \[\[x, y\], ...\]}, got \[\[1, 2\]\]'),
    (
        points('{"cones": [[1, 2], [true, 4]]}'),
        r"turn_1/points.json: 'cones': expected points \[x, y\], got \[true, 4\]",
    ),
    (points('{"cones": 3}'), r"turn_1/points.json: 'cones': expected points \[x, y\], got 3"),
    (points('{"cones": [[1, NaN]]}'), r"turn_1/points.json: 'cones': expected points \[x, y\], got \[1, NaN\]"),
    (
        points('{"cones": [[1, 384.5]]}'),
        r"turn_1/points.json: 'cones': expected points within 384 x 384 pixels, got \[1, 384.5\]",
    ),
    (
        points('{"cones": [[1, 1%s]]}' % ("0" * 400)),
        r"turn_1/points.json: 'cones': expected points within 384 x 384 pixels, got \[1, 10000",
    ),
    (
        lambda folder: clear(folder, np.s_[:3]),
        r"straight_1/road.png: expected the road to reach the side N, which the tile opens \(see \[opens\] in "
        r"tileset.toml\), got road on 0 of its 384 pixels; it ends 3 pixels short of it",
    ),
    (
        lambda folder: (folder / "crossing3_1" / "road.png").write_bytes(
            (folder / "crossing4_1" / "road.png").read_bytes()
        ),
        r"crossing3_1/road.png: expected the road to end before the side E \(see .*\), got road on 284 of its 384",
    ),
    (toml('[opens]\nbridge = "NS"'), r"tileset.toml: expected in \[opens\] kinds \(turn, .*\) or tiles, got 'bridge'"),
    (
        toml('[opens]\nturn = "NS"'),
        r"tileset.toml: expected turn to open 2 sides that meet, as letters of NESW, got 'NS'",
    ),
    (
        toml('[opens]\nstraight_2 = "NX"'),
        r"tileset.toml: expected straight_2 to open 2 sides that face each other, as letters of NESW, got 'NX'",
    ),
]


@pytest.mark.parametrize(("spoil", "message"), SPOILS)
def test_what_is_wrong_is_named(spoil, message, folder, capfd):
    for tile in [*folder.glob("*_[34]"), *folder.glob("crossing3_2"), *folder.glob("end_*")]:
        shutil.rmtree(tile)  # half of the tiles are read in half of the time
    spoil(folder)
    with pytest.raises(ValueError, match=message):
        load_tiles(folder)
    assert not "".join(capfd.readouterr()), "libraries keep silent"


def test_all_that_is_wrong_is_found_at_once(folder):
    (folder / "turn_2" / "red.png").unlink()
    write(folder, "straight_1/road.png", np.zeros((100, 90), np.uint8))
    tiles, problems = inspect_tiles(folder)
    assert tiles is None
    assert len(problems) == 2
    with pytest.raises(ValueError, match="turn_2: .* \\(and 1 more; see: elitelanes tiles check\\)"):
        load_tiles(folder)


def test_no_folder(tmp_path):
    with pytest.raises(ValueError, match="nowhere: expected a folder of tile pictures, got none"):
        load_tiles(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="file: expected a folder of tile pictures, got a file"):
        load_tiles(tmp_path / "file")

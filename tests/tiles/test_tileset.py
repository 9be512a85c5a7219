"""Tile sets: the drawn one, the photographed one, and all that can be wrong with a folder."""

import os
import shutil
import struct
import zlib

import cv2
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax.network.codes import CONNECTIONS, ROAD_ALPHABET
from elitelanes_jax.tiles import TileSet
from elitelanes_jax.tiles.tileset import default_tiles, describe_tiles, load_tiles


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


def test_a_description(drawn_tiles):
    text = describe_tiles(drawn_tiles)
    assert "Elite Lanes drawn tiles: 14 tiles, licence Apache-2.0" in text
    assert "crossing3_2  opens NSW   384 x 384 pixels" in text
    assert "56 pictures of the codes 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15" in text


def test_a_tile_opens_the_sides_that_its_road_reaches(folder):
    for file in (folder / "turn_2").iterdir():
        picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(file), np.ascontiguousarray(np.rot90(picture)))
    (folder / "tileset.toml").unlink()
    tiles = load_tiles(folder)
    assert tiles.name == "tiles"
    assert tiles.licence == ""
    assert [tile.code for tile in tiles.tiles[:3]] == [3, 6, 3]


def test_a_set_may_lack_ends_and_four_way_crossings_and_numbers_are_sorted_as_numbers(folder):
    without("end_*")(folder)
    tiles = load_tiles(folder)
    assert tiles.alphabet == ROAD_ALPHABET
    assert "no end: maps with dead ends cannot be drawn" in describe_tiles(tiles)
    without("crossing4_1")(folder)
    shutil.copytree(folder / "turn_1", folder / "turn_10")
    tiles = load_tiles(folder)
    assert tiles.alphabet == ROAD_ALPHABET[:-1]
    assert [tile.name for tile in tiles.tiles][:5] == ["turn_1", "turn_2", "turn_3", "turn_4", "turn_10"]


def test_a_set_may_say_where_its_lanes_run(folder):
    assert load_tiles(folder).lane_offset == 0.2
    with (folder / "tileset.toml").open("a") as file:
        file.write("lane_offset = 0.21\n")
    assert load_tiles(folder).lane_offset == 0.21


def test_masks_of_zeros_and_ones_and_grey_pictures_are_fine(folder):
    mask = cv2.imread(str(folder / "turn_1" / "road.png"), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(folder / "turn_1" / "road.png"), mask // 255)
    cv2.imwrite(str(folder / "turn_1" / "image.png"), mask)
    tile = load_tiles(folder).tiles[0]
    np.testing.assert_array_equal(tile.road, mask > 0)
    np.testing.assert_array_equal(tile.image[..., 2], mask)


def write(folder, name, picture):
    cv2.imwrite(str(folder / name), picture)


def clear(folder, part):
    mask = cv2.imread(str(folder / "straight_1" / "road.png"), cv2.IMREAD_GRAYSCALE)
    mask[part] = 0
    write(folder, "straight_1/road.png", mask)


def sparse(name):
    """A file of 20 GB without a single block on the disk."""
    return lambda folder: ((folder / name).touch(), os.truncate(folder / name, 20 * 2**30))


def make_folder(file):
    file.unlink()
    file.mkdir()


def text(name, content):
    return lambda folder: (folder / name).write_text(content)


def drawn(name, picture):
    return lambda folder: write(folder, name, picture)


def image(change):
    """Other bytes instead of a tile's picture, made from those that were there."""
    return lambda folder: (folder / "turn_1/image.png").write_bytes(change((folder / "turn_1/image.png").read_bytes()))


def without(pattern):
    return lambda folder: [shutil.rmtree(place) for place in folder.glob(pattern)]


def misnamed(name, *lost):
    """A tile's folder under another name, without some of its files."""

    def spoil(folder):
        for file in lost:
            (folder / "turn_1" / file).unlink()
        (folder / "turn_1").rename(folder / name)

    return spoil


def png(width, height, rows):
    """A PNG file of a grey picture, chunk by chunk."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


TOMLS = {
    'name = "My city\\n"': r"expected name to be a line of text, got 'My city\\n'",
    'name = "a"\nlicence = """\nMIT\n"""': r"expected licence to be a line of text, got 'MIT\\n'",
    "name =": "expected TOML, got ",
    "name = " + "[" * 10_000: "expected TOML, got ",
    "name = " + "9" * 10_000: "expected TOML, got Exceeds the limit",
    "a." * 20_000 + "a = 1": "expected TOML, got a key of more than 32 parts",
    "name = 'a'\n[" + "'a' . " * 32 + "a]": "expected TOML, got a key of more than 32 parts",
    "name" + ".a" * 30 + " = 1": r"expected name to be a line of text, got {'a': {'a': .{0,80}$",
    'name = " "': "expected name to be a line of text, got ' '",
    'licence = "MIT\\n# of a card"': "expected licence to be a line of text, got 'MIT",
    "name = 3": "expected name to be a line of text, got 3",
    'blend = "off"': "expected blend to be true or false, got 'off'",
    'license = "MIT"': "expected the keys name, licence, blend, lane_offset, lane_offset_spread, got 'license'",
    "lane_offset_spread = -0.1": "expected lane_offset_spread to be a number from 0 to under 0.5, got -0.1",
    "lane_offset_spread = true": "expected lane_offset_spread to be a number from 0 to under 0.5, got True",
    "lane_offset = 0.5": "expected lane_offset to be a number over 0 and under 0.5, got 0.5",
    "lane_offset = 0": "expected lane_offset to be a number over 0 and under 0.5, got 0",
    "lane_offset = nan": "expected lane_offset to be a number over 0 and under 0.5, got nan",
    "lane_offset = true": "expected lane_offset to be a number over 0 and under 0.5, got True",
    'lane_offset = "0.21"': "expected lane_offset to be a number over 0 and under 0.5, got '0.21'",
}
GREY = "expected a mask of two values, 0 and one other, got"
PICTURES = {
    "straight_1/road.png": (np.zeros((100, 90)), "expected 384 x 384 pixels like image.png, got 90 x 100"),
    "turn_1/yellow.png": (np.full((384, 384), [[0, 7, 9] * 128]), f"{GREY} 3: 0, 7, 9"),
    "turn_2/yellow.png": (np.full((384, 384), [[1, 255] * 192]), f"{GREY} 2: 1, 255"),
    "turn_1/red.png": (np.full((384, 384, 3), [0, 0, 255]), "expected a grey mask, got one in colours"),
    "turn_1/image.png": (np.zeros((384, 300, 3)), "expected a square picture, got 300 x 384 pixels"),
}
NO_PNG = "expected a PNG picture of 8 bits a channel, got"
BYTES = [
    (lambda before: b"no picture", f"{NO_PNG} one that cannot be read"),
    (lambda before: before[:9000], f"{NO_PNG} one that cannot be read"),
    (lambda before: before.replace(b"\x55", b"\x56"), f"{NO_PNG} one that cannot be read"),
    (lambda before: b"", f"{NO_PNG} one that cannot be read"),
    (lambda before: png(0, 0, b""), f"{NO_PNG} one that cannot be read"),
    (lambda before: png(60_000, 60_000, b"\0" * 99), "it has 60000 x 60000 pixels, not 1 to 4096 a side"),
    (lambda before: cv2.imencode(".png", np.zeros((384, 384, 3), np.uint16))[1].tobytes(), f"{NO_PNG} uint16"),
]
SPOILS = [
    *((text("tileset.toml", content), f"tileset.toml: {words}") for content, words in TOMLS.items()),
    *((drawn(file, pixels.astype(np.uint8)), f"{file}: {words}") for file, (pixels, words) in PICTURES.items()),
    *((image(change), f"turn_1/image.png: .*{words}") for change, words in BYTES),
    (lambda folder: (folder / "turn_2/red.png").unlink(), "turn_2: expected image.png, road.png, .*, got no red.png"),
    (
        lambda folder: (folder / "turn_2/image.png").rename(folder / "turn_2/Image.JPG"),
        "turn_2: expected .*, got no image.png; save Image.JPG as image.png$",
    ),
    (lambda folder: make_folder(folder / "turn_2/image.png"), r"turn_2: expected .*, got no image.png$"),
    (without("crossing*"), r"expected tiles of every kind a map needs .*, got no crossing"),
    (without("straight*"), r"expected tiles of every kind a map needs .*, got no straight"),
    (without("*_*"), r"got no straight and no turn and no crossing"),
    (misnamed("trun_1"), r"trun_1: expected a folder <kind>_<number>, the kind one of turn, straight, crossing3"),
    (misnamed("Turn_1", "image.png", "red.png"), r"Turn_1: expected a folder <kind>_<number>"),
    (sparse("tileset.toml"), r"tileset.toml: expected a file of at most 1 MiB, got a larger one"),
    (sparse("turn_1/image.png"), r"turn_1/image.png: expected a file of at most 72 MiB, got a larger one"),
    (
        lambda folder: clear(folder, np.s_[:3]),
        "straight_1/road.png: expected a road that reaches two sides that face each other of the tile, got S",
    ),
    (
        lambda folder: shutil.copy(folder / "crossing4_1/road.png", folder / "crossing3_1"),
        "crossing3_1/road.png: expected a road that reaches three sides of the tile, got N, E, S, W",
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


def test_a_picture_with_too_few_pixels_is_refused(folder):
    (folder / "turn_1/image.png").write_bytes(png(384, 384, b"\0" * 99))
    with refused("", "...tiles/turn_1/image.png...got one that cannot be read"):
        load_tiles(folder)


@pytest.mark.parametrize(
    ("change", "subject", "got"),
    [
        ({"image": np.zeros((64, 64, 3))}, "tiles[1]: image", "float64 [64, 64, 3]"),
        ({"image": np.zeros((64, 64, 3), np.uint16)}, "tiles[1]: image", "uint16 [64, 64, 3]"),
        ({"image": np.zeros((64, 64, 4), np.uint8)}, "tiles[1]: image", "uint8 [64, 64, 4]"),
        ({"image": np.zeros((64, 32, 3), np.uint8)}, "tiles[1]: image", "uint8 [64, 32, 3]"),
        ({"image": [[0]]}, "tiles[1]: image", "[[0]]"),
        ({"road": np.full((64, 64), 255, np.uint8)}, "tiles[1]: road", "uint8 [64, 64]"),
        ({"red": np.ones((9, 64), bool)}, "tiles[1]: red", "bool [9, 64]"),
        ({"yellow": np.ones((32, 32), bool)}, "tiles[1]: yellow", "[32, 32]"),
        ({"opaque": np.ones((64, 64))}, "tiles[1]: opaque", "float64 [64, 64]"),
        ({"code": 99}, "tiles[1]: code", "99"),
    ],
)
def test_a_tile_of_other_types_or_shapes_is_refused(change, subject, got, drawn_tiles):
    """A picture from 0 to 1 was drawn black, and a mask of another size or of 255 gave wrong labels or a traceback."""
    mask = np.ones((64, 64), bool)
    tile = drawn_tiles.tiles[0]._replace(image=np.zeros((64, 64, 3), np.uint8), road=mask, red=mask, yellow=mask)
    assert TileSet("own", "", (tile,)).tiles == (tile,)
    with refused(subject, got):
        TileSet("own", "", (tile, tile._replace(**change)))


def test_a_set_without_tiles_is_refused():
    with refused("tiles", "none"):
        TileSet("own", "", ())

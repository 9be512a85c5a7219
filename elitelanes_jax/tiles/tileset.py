"""Tile sets: folders of elementary tile pictures with their masks.

A tile set has sub-folders ``<kind>_<n>``, the kind one of turn, straight, crossing3, crossing4,
end. Each has ``image.png``, the picture of one square tile, and the masks ``road.png``, ``red.png``
(stop lines) and ``yellow.png`` (lane separators) of the same size: grey, of 0 and one other value.

A transparent pixel of a mask is 0. A transparent pixel of a picture is ground: it has the colour of
empty cells, and no mask is there.

A tile opens the sides that its road reaches. New maps have no dead ends: an end is for maps drawn
by hand or repaired. An optional ``tileset.toml`` has a ``name`` and a ``licence``. Without ``blend
= false`` the tiles are blended as photographs, whose light differs. ``lane_offset`` says where
lanes run: tiles from the road's middle to a lane's centre. ``lane_offset_spread`` is its standard
deviation, if it was measured.

Tiles are rotated by quarters, never mirrored: traffic keeps right, and a mirrored crossing would
have its stop lines on the wrong side.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple, TypedDict, cast

import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import (
    check_named,
    flag,
    instance,
    is_folder,
    is_real,
    listed,
    none_or,
    path,
    path_exists,
    real,
    whole,
)
from elitelanes_jax._util.errors import InputError, brief
from elitelanes_jax._util.files import read_toml
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.lanes.curves import LANE_OFFSET, check_lane_offset, is_lane_offset
from elitelanes_jax.network.codes import CONNECTIONS, KINDS, SIDES, Side, rotate_codes
from elitelanes_jax.tiles._lines import misplaced_lines
from elitelanes_jax.tiles.files import GROUND, Tile, read_image, read_mask, size_of

MASKS = ("road", "red", "yellow")
"""The masks of a tile, by the names of their files."""

_EXPECTED = {
    "turn": "two sides that meet",
    "straight": "two sides that face each other",
    "crossing3": "three sides",
    "crossing4": "all four sides",
    "end": "one side",
}
_FILES = ("image", *MASKS)


def _is_line(value: Plain) -> bool:
    """Returns whether a value is one line of text, as cards and messages have it."""
    # A text such as "My city\n" has one line, but it ends.
    return isinstance(value, str) and "".join(value.splitlines()) == value


def _is_name(value: Plain) -> bool:
    return _is_line(value) and bool(str(value).strip())


def _is_truth_value(value: Plain) -> bool:
    return isinstance(value, bool)


def _is_spread(value: Plain) -> bool:
    return is_real(value) and 0 <= value < 0.5


# The keys of tileset.toml: a test of the value, and what is expected, for messages.
_KEYS: dict[str, tuple[Callable[[Plain], bool], str]] = {
    "name": (_is_name, "name to be a line of text"),
    "licence": (_is_line, "licence to be a line of text"),
    "blend": (_is_truth_value, "blend to be true or false"),
    "lane_offset": (is_lane_offset, "lane_offset to be a number over 0 and under 0.5"),
    "lane_offset_spread": (_is_spread, "lane_offset_spread to be a number from 0 to under 0.5"),
}


class _About(TypedDict, total=False):
    """The fields of tileset.toml, see `TileSet`."""

    name: str
    licence: str
    blend: bool
    lane_offset: float
    lane_offset_spread: float


# The least part of a side that is road if a road reaches it.
_TOUCHES = 0.1


class RotatedTile(NamedTuple):
    """A rotated tile of a set.

    Attributes:
      tile: the index of the tile in `TileSet.pictures`.
      quarter_turns: the quarter turns counter-clockwise, 0 to 3.
    """

    tile: int
    quarter_turns: int


@dataclass(frozen=True, eq=False)
class TileSet:
    """A set of elementary tiles.

    Attributes:
      name: the name of the set.
      licence: the licence of its pictures, as stated by its makers; empty if none is.
      tiles: sorted by kind and number.
      blend: whether the tiles are blended on a map, as photographs need it: equal light, feathered
        seams.
      lane_offset: tiles from the road's middle to the centre of a lane, over 0 and under 0.5.
      lane_offset_spread: the standard deviation of the lane offsets at the sides of the tiles, if
        `tiles cut` measured them; otherwise None.
    """

    name: str
    licence: str
    tiles: tuple[Tile, ...]
    blend: bool = False
    lane_offset: float = LANE_OFFSET
    lane_offset_spread: float | None = None

    def __post_init__(self) -> None:
        """Checks the fields, and those of the tiles, whose arrays nobody can change."""
        for name in ("name", "licence"):
            check_named(name, instance(str), getattr(self, name))
        check_named("blend", flag, self.blend)
        check_named("lane_offset", check_lane_offset, self.lane_offset)
        check_named("lane_offset_spread", none_or(real(0)), self.lane_offset_spread)
        tiles = check_named("tiles", listed(Tile), self.tiles)
        if not tiles:
            raise InputError("tiles", "one or more", "none")
        for index, tile in enumerate(tiles):
            check_named(f"tiles[{index}]", _check_tile, tile)
        object.__setattr__(self, "tiles", tuple(tiles))

    @cached_property
    def pictures(self) -> tuple[Tile, ...]:
        """The tiles, and after them the bare ground of empty cells, in one colour."""
        size = self.tiles[0].image.shape[0]
        nothing = np.zeros((size, size), bool)
        grass = np.full((size, size, 3), GROUND, np.uint8)
        return (*self.tiles, Tile("ground", 0, grass, nothing, nothing, nothing, opaque=nothing))

    @cached_property
    def rotations(self) -> dict[int, tuple[RotatedTile, ...]]:
        """All tiles and rotations that draw each code of the set. Empty cells are bare ground."""
        draws: dict[int, list[RotatedTile]] = {}
        for index, tile in enumerate(self.pictures):
            for turns in range(4):
                draws.setdefault(rotate_codes(tile.code, turns), []).append(
                    RotatedTile(index, turns)
                )
        return {code: tuple(draws[code]) for code in sorted(draws)}

    @cached_property
    def digest(self) -> str:
        """A digest of all names, pictures and masks."""
        digest = sha256(repr((self.name, self.licence)).encode())
        for tile in self.tiles:
            digest.update(repr((tile.name, tile.code, tile.image.shape)).encode())
            for layer in (tile.image, tile.road, tile.red, tile.yellow, tile.opaque):
                if layer is not None:
                    digest.update(np.ascontiguousarray(layer).tobytes())
        return digest.hexdigest()[:16]

    @cached_property
    def picture_digests(self) -> dict[str, str]:
        """A digest of the picture of each tile, by the tile's name; masks have no part in it."""
        digests = {}
        for tile in self.tiles:
            digest = sha256(repr(tile.image.shape).encode())
            for layer in (tile.image, tile.opaque):
                if layer is not None:
                    digest.update(np.ascontiguousarray(layer).tobytes())
            digests[tile.name] = digest.hexdigest()[:16]
        return digests

    def to_plain(self) -> dict[str, Plain]:
        """Returns all that pictures of maps depend on, as plain values for JSON.

        The pictures are represented by their digest.
        """
        about: dict[str, Plain] = {
            name: getattr(self, name) for name in ("name", "licence", "blend")
        }
        if self.lane_offset != LANE_OFFSET:
            about["lane_offset"] = self.lane_offset
        return about | {"tiles": self.digest}

    @property
    def alphabet(self) -> tuple[int, ...]:
        """The codes of new maps, sorted.

        These are the codes with two or more connections that the set's tiles draw.
        """
        return tuple(code for code in self.rotations if CONNECTIONS[code] >= 2)


def _check_tile(tile: Tile) -> None:
    """Checks the fields of a tile.

    NumPy and OpenCV also compute with other numbers and shapes, and draw wrong pictures and labels.
    """
    check_named("name", instance(str), tile.name)
    check_named("code", whole(0, 15), tile.code)
    side = _check_layer("image", tile.image, np.uint8, "uint8 [S, S, 3]", (3,))
    for name in (*MASKS, "opaque"):
        mask = getattr(tile, name)
        if mask is None and name == "opaque":
            continue
        expected = f"bool [{side}, {side}], as large as the image"
        if _check_layer(name, mask, np.bool_, expected) != side:
            raise InputError(name, expected, list(mask.shape))


def _check_layer(
    name: str, layer: UserValue, kind: type, expected: str, channels: tuple[int, ...] = ()
) -> int:
    """Checks the type of a square picture or mask, and returns its side."""
    if not isinstance(layer, np.ndarray):
        raise InputError(name, expected, brief(layer))
    side = len(layer) if layer.ndim else 0
    if layer.dtype != kind or not side or layer.shape != (side, side, *channels):
        raise InputError(name, expected, f"{layer.dtype} {list(layer.shape)}")
    return side


@name_wrong_arguments
def default_tiles() -> Path:
    """Returns the folder of the package's own tile set."""
    # An installed package has the tiles next to this file. A checkout has them in its top folder.
    installed = Path(__file__).parent / "drawn"
    if installed.is_dir():
        return installed
    return Path(__file__).parents[2] / "tiles"


@name_wrong_arguments
def load_tiles(folder: str | Path | None = None) -> TileSet:
    """Loads a tile set.

    Files and sizes are checked, and that roads reach as many sides as their kind has. The positions
    of lines are not checked, because photographs of unusual roads need judgement; `elitelanes tiles
    check` reports them.

    Args:
      folder: the folder of the set; by default the package's own.

    Raises:
      InputError: for an error in the folder; the message names the file.
    """
    if folder is None:
        folder = default_tiles()
    tiles, problems = inspect_tiles(check_named("folder", path, folder))
    if tiles is None:
        message = problems[0]
        if len(problems) > 1:
            message += f" (and {len(problems) - 1} more; see: elitelanes tiles check)"
        raise InputError("", "", message)
    return tiles


@cache
def own_tiles() -> TileSet:
    """Returns the package's own tile set. It is read once."""
    return load_tiles()


@name_wrong_arguments
def inspect_tiles(folder: str | Path, *, lines: bool = False) -> tuple[TileSet | None, list[str]]:
    """Returns a tile set and no problems, or None and all problems of the folder, a line each.

    With `lines`, misplaced roads and lines are problems too. A road must reach the sides that its
    tile opens, and no other. Lines must be on the road, separators in its middle, and stop lines
    across the incoming lanes of crossings.
    """
    folder = Path(check_named("folder", path, folder))
    problems: list[str] = []
    about = _about(folder / "tileset.toml", problems)
    tiles = []
    for tile_folder in tile_folders(folder, problems):
        tile = _load_tile(tile_folder, problems)
        if tile is not None:
            tiles.append(tile)
    if lines:
        for tile_name, mask, fault in misplaced_lines(tiles):
            problems.append(f"{folder / tile_name / mask}.png: {fault}")
    missing = _missing_kinds(tiles)
    # A kind may be missing because its folder has an error.
    if missing and not problems:
        problems.append(
            f"{folder}: expected tiles of every kind a map needs "
            "(straight, turn, crossing3 or crossing4), "
            f"got no {' and no '.join(missing)}"
        )
    if problems:
        return None, problems
    tile_set = TileSet(
        name=about.get("name", folder.resolve().name),
        licence=about.get("licence", ""),
        tiles=tuple(tiles),
        blend=about.get("blend", True),
        lane_offset=float(about.get("lane_offset", LANE_OFFSET)),
        lane_offset_spread=about.get("lane_offset_spread"),
    )
    return tile_set, []


def _missing_kinds(tiles: Iterable[Tile]) -> list[str]:
    """Returns the kinds that every map needs and the tiles lack."""
    absent = _absent_kinds(tiles)
    missing: list[str] = [kind for kind in ("straight", "turn") if kind in absent]
    if "crossing3" in absent and "crossing4" in absent:
        missing.append("crossing")
    return missing


def tile_folders(folder: Path, problems: list[str]) -> list[Path]:
    """Returns the folders of a set's tiles by kind and number.

    Folders with other names are added to the problems.
    """
    if not is_folder(folder):
        got = "a file" if path_exists(folder) else "none"
        problems.append(f"{folder}: expected a folder of tile pictures, got {got}")
        return []
    kinds = list(_EXPECTED)
    # The folders with the indices of their kinds, and their numbers.
    folders: list[tuple[int, int, Path]] = []
    for entry in folder.iterdir():
        if not entry.is_dir():
            continue
        name = re.fullmatch(r"([a-z]+\d?)_(\d+)", entry.name)
        if name and name[1] in kinds:
            folders.append((kinds.index(name[1]), int(name[2]), entry))
        elif any((entry / f"{file}.png").exists() for file in _FILES):
            problems.append(
                f"{entry}: expected a folder <kind>_<number>, the kind one of {', '.join(kinds)}"
            )
    return [entry for _, _, entry in sorted(folders)]


def edge_pixels(picture: np.ndarray, side: Side) -> np.ndarray:
    """Returns the outermost pixels along a side of a picture, seen from inside.

    The picture is ``[S, S, ...]``, and the result ``[S, ...]``.
    """
    return np.rot90(picture, SIDES.index(side))[0]


def describe_tiles(tiles: TileSet) -> str:
    """Returns a few lines of text about a set and the codes that it draws."""
    head = f"{tiles.name}: {len(tiles.tiles)} tiles"
    if tiles.licence:
        head += f", licence {tiles.licence}"
    lines = [head]
    for tile in tiles.tiles:
        sides = "".join(side.letter for side in SIDES if tile.code & side.bit)
        shares = ", ".join(f"{name} {share:.1%}" for name, share in tile.transparent.items())
        see_through = f", transparent: {shares}" if shares else ""
        lines.append(f"  {tile.name:12} opens {sides:4}  {size_of(tile.image)} pixels{see_through}")
    # Empty cells, of code 0, are no pictures of the set.
    drawn = {code: len(draws) for code, draws in tiles.rotations.items() if code}
    lines.append(
        f"rotated, {sum(drawn.values())} pictures of the codes {', '.join(map(str, drawn))}"
    )
    for kind in _absent_kinds(tiles.tiles):
        effect = "maps with dead ends cannot be drawn" if kind == "end" else "maps will have none"
        lines.append(f"no {kind}: {effect}")
    if any(tile.transparent for tile in tiles.tiles):
        lines.append(
            "transparent pixels of a mask are 0; those of a picture are ground, "
            "without road and lines"
        )
    if not any(tile.yellow.any() for tile in tiles.tiles):
        lines.append("no lane separators")
    return "\n".join(lines)


def _absent_kinds(tiles: Iterable[Tile]) -> list[str]:
    drawn = {tile.code for tile in tiles}
    return [kind for kind in _EXPECTED if not drawn & set(KINDS[kind])]


def _about(file: Path, problems: list[str]) -> _About:
    """Reads tileset.toml and checks it; returns what is right."""
    if not path_exists(file):
        return {}
    try:
        about = read_toml(file, str(file))
    except InputError as error:
        problems.append(str(error))
        return {}
    right = {}
    for key, value in about.items():
        if key not in _KEYS:
            keys = ", ".join(_KEYS)
            problems.append(f"{file}: expected the keys {keys}, got {brief(key)}")
            continue
        is_right, expected = _KEYS[key]
        if is_right(value):
            right[key] = value
        else:
            problems.append(f"{file}: expected {expected}, got {brief(value)}")
    # `_KEYS` has a test for each field.
    return cast("_About", right)


def _names_to_save(folder: Path, missing: list[str]) -> str:
    """Returns the end of a message about missing files.

    It says which files of the folder, such as image.jpg, to save under the missing names.
    """
    files = sorted(file.name for file in folder.iterdir() if file.is_file())
    advice = ""
    for name in missing:
        alike = [file for file in files if Path(file).stem.lower() == Path(name).stem]
        if alike:
            advice += f"; save {alike[0]} as {name}"
    return advice


def _load_tile(folder: Path, problems: list[str]) -> Tile | None:
    before = len(problems)
    missing = [f"{name}.png" for name in _FILES if not (folder / f"{name}.png").is_file()]
    if missing:
        problems.append(
            f"{folder}: expected image.png, road.png, red.png and yellow.png, "
            f"got no {', '.join(missing)}"
            f"{_names_to_save(folder, missing)}"
        )
    # All files are read, so that one call names all problems.
    image = read_image(folder / "image.png", problems)
    road = read_mask(folder / "road.png", image, problems)
    red = read_mask(folder / "red.png", image, problems)
    yellow = read_mask(folder / "yellow.png", image, problems)
    if image is None or road is None or red is None or yellow is None or len(problems) > before:
        return None
    # Transparent pixels of the picture are ground, where no road is.
    opaque_road = road.pixels & image.opaque
    # The code follows from the road. The folder's kind must have this code.
    reached = [side for side in SIDES if edge_pixels(opaque_road, side).mean() >= _TOUCHES]
    code = sum(side.bit for side in reached)
    kind = folder.name.rpartition("_")[0]
    if code not in KINDS[kind]:
        got = ", ".join(side.letter for side in reached) or "none"
        if (road.pixels & ~image.opaque).any():
            got += ", because image.png is transparent on a part of the road"
        problems.append(
            f"{folder / 'road.png'}: expected a road that reaches {_EXPECTED[kind]} of the tile, "
            f"got {got}"
        )
        return None
    layers = {"image": image, "road": road, "red": red, "yellow": yellow}
    return Tile(
        name=folder.name,
        code=code,
        image=image.pixels,
        road=opaque_road,
        red=red.pixels & image.opaque,
        yellow=yellow.pixels & image.opaque,
        opaque=None if image.opaque.all() else image.opaque,
        transparent={
            name: layer.transparent for name, layer in layers.items() if layer.transparent
        },
    )

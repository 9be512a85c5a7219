"""Rendering: from a grid to one picture, its masks and its label map.

See the paper, "Real-World Data Integration".
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.checks import (
    TILE_PX,
    check_named,
    file_named,
    listed,
    path,
    real,
    whole,
)
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.objects import OPAQUE, MapObject, Standing
from elitelanes_jax.formats.road_map import Drawn, RoadMap, as_map
from elitelanes_jax.network.checks import known_grid
from elitelanes_jax.network.codes import KIND_OF
from elitelanes_jax.tiles._blend import Equations, feather, lay_toned, solve_tones
from elitelanes_jax.tiles._lots import draw_lots
from elitelanes_jax.tiles.files import GROUND
from elitelanes_jax.tiles.object_set import ObjectSet, lay_all_flat, load_objects
from elitelanes_jax.tiles.pasting import paste_objects
from elitelanes_jax.tiles.tileset import MASKS, RotatedTile, TileSet, load_tiles, own_tiles

LABELS = ("background", "road", "stop line", "lane separator")
"""The classes of a label map: a label is an index in this list. Lines cover the road."""

LABEL_COLOURS = ((40, 40, 48), (110, 150, 180), (235, 60, 60), (255, 215, 60))
"""A colour for each label, RGB."""

COMPARED_PX = 64
"""The side of a tile in pixels at which the light of tiles is compared.

It is the same for all sizes of pictures.
"""

# The longest side of a picture that the encoder of PNG files takes, in pixels.
_LONGEST_PNG = 1_000_000

_L = TypeVar("_L", np.uint8, np.bool_)


class Picture(NamedTuple):
    """A rendered grid of H x W tiles of P pixels each.

    Attributes:
      image: uint8 ``[H·P, W·P, 3]``, RGB.
      road: uint8 ``[H·P, W·P]``, 0 or 255, the drivable surface.
      red: uint8 ``[H·P, W·P]``, 0 or 255, the stop lines.
      yellow: uint8 ``[H·P, W·P]``, 0 or 255, the lane separators.
      labels: uint8 ``[H·P, W·P]``, indices in `LABELS`.
      instances: uint16 ``[H·P, W·P]``, 0, or the number of the object that is seen, its index on
        the map plus 1; None without objects. Where there is an object, masks and labels are 0.
    """

    image: NDArray[np.uint8]
    road: NDArray[np.uint8]
    red: NDArray[np.uint8]
    yellow: NDArray[np.uint8]
    labels: NDArray[np.uint8]
    instances: NDArray[np.uint16] | None = None

    @name_wrong_arguments
    def save(self, folder: str | Path) -> None:
        """Writes image.png, a PNG file for each mask, and labels.png.

        A picture with objects also gets instances.png, of 16 bits per pixel.

        Args:
          folder: made if it does not exist. Files of the same names are replaced.

        Raises:
          OSError: if a file cannot be written.
        """
        folder = Path(check_named("folder", path, folder))
        folder.mkdir(parents=True, exist_ok=True)
        for name in ("image", *MASKS, "labels"):
            write_png(folder / f"{name}.png", getattr(self, name))
        if self.instances is not None:
            write_png(folder / "instances.png", self.instances)

    @name_wrong_arguments
    def overlay(self, opacity: float = 0.6) -> NDArray[np.uint8]:
        """Lays the labels over the picture in colour, uint8 ``[H·P, W·P, 3]``, RGB; `opacity` is 0 to 1."""
        check_named("opacity", real(0, 1), opacity)
        colours = np.array(LABEL_COLOURS, np.uint8)[self.labels]
        return np.asarray(cv2.addWeighted(self.image, 1 - opacity, colours, opacity, 0), np.uint8)


@name_wrong_arguments
def choose_tiles(grid: ArrayLike, tiles: TileSet, seed: int | list[int] = 0) -> NDArray[np.int_]:
    """Chooses a picture for each cell at random among all that show its code.

    Args:
      grid: codes ``[H, W]``.
      tiles: whose pictures to choose from.
      seed: the seed of a `numpy.random.default_rng`; equal seeds give equal choices.

    Returns:
      int ``[H, W, 2]``, the index of the tile in the set and its quarter turns counter-clockwise.

    Raises:
      InputError: for a bad grid, or if the set has no picture for a cell.
    """
    return plan_choice(grid, tiles).choose(seed)


class TileChoice(NamedTuple):
    """The pictures among which `choose_tiles` chooses for the cells of a grid.

    Attributes:
      pictures: int ``[N, 2]``, the tiles and quarter turns of all codes.
      first: int ``[H, W]``, the index of the cell's first picture.
      choices: int ``[H, W]``, the number of the cell's pictures.
    """

    pictures: NDArray[np.int_]
    first: NDArray[np.int_]
    choices: NDArray[np.int_]

    def choose(self, seed: int | list[int]) -> NDArray[np.int_]:
        """Chooses a picture for each cell; see `choose_tiles` for the result and the error."""
        lots = draw_lots(seed, self.first.shape)
        return self.pictures[self.first + (lots * self.choices).astype(int)]


def first_undrawn(grid: NDArray[np.integer], tiles: TileSet) -> tuple[int, str] | None:
    """Finds the first cell of a grid that a tile set has no picture of; None if there is none.

    Returns its code, and a text such as "15 (crossing4) at B2 ([1, 1])".
    """
    cells = np.argwhere(~np.isin(grid, list(tiles.rotations)))
    if not len(cells):
        return None
    row, column = cells[0]
    code = int(grid[row, column])
    return code, f"{code} ({KIND_OF[code]}) at {describe_cell(row, column)}"


def plan_choice(grid: ArrayLike, tiles: TileSet) -> TileChoice:
    """Lists the pictures of each cell of a grid; the errors are those of `choose_tiles`."""
    grid = known_grid(grid)
    if not isinstance(tiles, TileSet):
        raise InputError("tiles", "a TileSet, as load_tiles gives it", quote(tiles))
    undrawn = first_undrawn(grid, tiles)
    if undrawn is not None:
        code, cell = undrawn
        drawn = ", ".join(str(code) for code in tiles.rotations if code)
        remedy = ""
        if KIND_OF[code] == "end":
            remedy = (
                "; a tile end_1 in the set would draw it, "
                "--dead-ends grass or without_dead_ends removes these roads"
            )
        raise InputError(
            "grid",
            f"tiles that the set {tiles.name!r} can draw (codes {drawn})",
            f"{cell}{remedy}",
        )
    # The pictures are listed code by code, so that a first index and a number tell those of a cell.
    pictures: list[RotatedTile] = []
    first, count = np.zeros((2, 16), int)
    for code, draws in tiles.rotations.items():
        first[code], count[code] = len(pictures), len(draws)
        pictures += draws
    return TileChoice(np.array(pictures), first[grid], count[grid])


@name_wrong_arguments
def render(
    source: UserValue,
    tiles: TileSet | str | Path | None = None,
    *,
    tile_px: int = 64,
    seed: int | None = None,
    chosen: UserValue = None,
    objects: ObjectSet | str | Path | None = None,
) -> Picture:
    """Draws a map, with its objects as seen from above.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, or a file. The set has a picture for each
        code.
      tiles: whose pictures to draw with, a set or its folder; by default the package's own.
      tile_px: side of a tile in pixels, 16 to 512.
      seed: the seed of the choice among the pictures of each code (see `choose_tiles`). By default
        a map is drawn with the same pictures as before, if the set has them; other maps have seed
        0.
      chosen: the choice, instead of the seed's.
      objects: the pictures of the map's objects, a set or its folder; by default the package's own.

    Raises:
      InputError: for a bad map, a cell or an object without picture in its set, a choice that does
        not show the grid, or a size out of its range.
    """
    tile_px = check_tile_px(tile_px)
    if not isinstance(tiles, TileSet):
        tiles = own_tiles() if tiles is None else load_tiles(check_named("tiles", path, tiles))
    road_map = as_map(source)
    if chosen is not None:
        chosen = _check_choice(road_map.codes, tiles, chosen)
    elif seed is None:
        chosen = recall_choice(road_map, tiles)
    if seed is None:
        seed = 0
    if chosen is None:
        chosen = choose_tiles(road_map.codes, tiles, seed)
    layers = _draw_layers(road_map.codes, tiles, chosen, tile_px)
    if objects is not None:
        # A wrong folder is refused for maps without objects too.
        objects = load_objects(objects)
    instances = None
    if road_map.objects:
        pictures = load_objects(objects).choose(road_map.objects, seed)
        placed, order = lay_all_flat(road_map.objects, pictures, tile_px)
        instances, _ = paste_objects(layers, placed, order)
    return Picture(**layers, instances=instances)


def _draw_layers(
    grid: NDArray[np.int8], tiles: TileSet, chosen: NDArray[np.int_], tile_px: int
) -> dict[str, NDArray[np.uint8]]:
    """Draws `Picture`'s layers of a map without its objects.

    `chosen` is what `choose_tiles` returns. Returns the layers by name, uint8 ``[H·P, W·P]`` and
    for "image" ``[H·P, W·P, 3]``, where P is `tile_px`.
    """
    picture = chosen[..., 0] * 4 + chosen[..., 1]
    scaled = scale_tiles(tiles, tile_px)
    layers = {
        name: _lay_out(layer, picture)
        for name, layer in scaled.items()
        if name != "image" or not tiles.blend
    }
    if not tiles.blend:
        return layers
    tones = solve_light(grid, tiles, chosen)
    image = feather(lay_toned(scaled["image"], picture, tones), layers["labels"], grid)
    if any(tile.opaque is not None for tile in tiles.tiles):
        # Transparent pixels show the ground of empty cells, whose light does not change.
        image[~show_paved(tiles, chosen, tile_px) & (layers["labels"] == 0)] = GROUND
    return layers | {"image": image}


def solve_light(
    grid: NDArray[np.int8], tiles: TileSet, chosen: NDArray[np.int_]
) -> NDArray[np.float64]:
    """Solves for the gains and offsets of blended tiles, see `solve_tones`.

    Compared at one size, tiles have one light at all sizes.
    """
    small = scale_tiles(tiles, COMPARED_PX)
    picture = chosen[..., 0] * 4 + chosen[..., 1]
    return solve_tones(grid, picture, small["image"], small["labels"], _known_equations(tiles))


@lru_cache(maxsize=4)
def _known_equations(_: TileSet) -> Equations:
    """Returns the table of equations of a tile set, which all its maps fill."""
    return {}


def check_tile_px(tile_px: UserValue) -> int:
    """Checks the side of a tile in pixels, 16 to 512."""
    return check_named("tile_px", TILE_PX, tile_px)


def record_choice(tiles: TileSet, chosen: NDArray[np.int_]) -> Drawn:
    """Returns the record of a choice of tiles that `choose_tiles` made."""
    names = [[tiles.pictures[tile].name for tile, _ in row] for row in chosen]
    # The bare ground of empty cells is the same in all sets.
    used = sorted({name for row in names for name in row} & tiles.picture_digests.keys())
    digests = {name: tiles.picture_digests[name] for name in used}
    return Drawn(tiles.name, names, chosen[..., 1].tolist(), digests)


def recall_choice(road_map: RoadMap, tiles: TileSet) -> NDArray[np.int_] | None:
    """Returns the choice of tiles that a map was drawn with, as `choose_tiles` makes it.

    Returns None if the map was not drawn, the set lacks a picture, or a tile does not show its
    cell's code. A set with these pictures may have another name, and more tiles.
    """
    drawn = road_map.drawn
    if drawn is None:
        return None
    # Without digests, the name of the set is all that is known.
    if drawn.digests is None and drawn.tile_set != tiles.name:
        return None
    if not _has_pictures(tiles, drawn):
        return None
    grid, names, turns = road_map.codes, np.array(drawn.tiles), np.array(drawn.quarter_turns)
    if not names.shape == turns.shape == grid.shape:
        return None
    indices = {tile.name: index for index, tile in enumerate(tiles.pictures)}
    if not set(names.flat) <= set(indices):
        return None
    chosen = np.stack([np.vectorize(indices.__getitem__)(names), turns], axis=-1)
    return chosen if _misfits(grid, tiles, chosen).size == 0 else None


def _has_pictures(tiles: TileSet, drawn: Drawn) -> bool:
    """Returns whether a set has all pictures whose digests a map records."""
    # Without digests, the pictures of the set need not be digested.
    return not drawn.digests or drawn.digests.items() <= tiles.picture_digests.items()


def describe_other_pictures(road_map: RoadMap, tiles: TileSet) -> str:
    """Returns a line about a set with the name of a map's set but without its pictures.

    Returns "" for any other set.
    """
    drawn = road_map.drawn
    if drawn is None or drawn.tile_set != tiles.name or _has_pictures(tiles, drawn):
        return ""
    return f"the tile set {tiles.name!r} has other pictures now; they are chosen anew"


def _check_choice(grid: ArrayLike, tiles: TileSet, chosen: UserValue) -> NDArray[np.int_]:
    grid = known_grid(grid)
    expected = f"integers of shape {(*grid.shape, 2)}"
    try:
        chosen = np.asarray(chosen)
    except ValueError:
        # The rows have several lengths.
        raise InputError("chosen", expected, quote(chosen)) from None
    if chosen.shape != (*grid.shape, 2) or not np.issubdtype(chosen.dtype, np.integer):
        raise InputError("chosen", expected, f"{chosen.dtype} of shape {chosen.shape}")
    for row, column in _misfits(grid, tiles, chosen):
        raise InputError(
            "chosen",
            (
                f"a tile of the set {tiles.name!r} rotated to show code {grid[row, column]} at "
                f"{describe_cell(row, column)}"
            ),
            f"tile {chosen[row, column, 0]} rotated {chosen[row, column, 1]} times",
        )
    # Four times an index overflows in 8 bits.
    return chosen.astype(int)


def _misfits(grid: NDArray[np.int8], tiles: TileSet, chosen: NDArray[np.int_]) -> NDArray[np.int_]:
    """Returns row and column of the cells whose chosen tile does not show their code."""
    # The table has the code that each picture shows in each rotation.
    shown = np.full((len(tiles.pictures), 4), -1)
    for code, draws in tiles.rotations.items():
        shown[tuple(np.array(draws).T)] = code
    known = (
        (chosen >= 0).all(axis=-1) & (chosen[..., 0] < len(tiles.pictures)) & (chosen[..., 1] < 4)
    )
    # Indices beyond the table are looked up as 0, and count as misfits anyway.
    safe = np.where(known[..., None], chosen, 0)
    return np.argwhere(~known | (shown[safe[..., 0], safe[..., 1]] != grid))


@name_wrong_arguments
def write_png(file: str | Path, pixels: NDArray[np.integer]) -> None:
    """Writes a PNG file of a picture, and makes missing folders.

    The picture is ``[H, W]``, in RGB ``[H, W, 3]``, or with opacity ``[H, W, 4]``. Raises
    `InputError` for a name that does not end in .png, values that are not uint8 or uint16, another
    shape, no pixel, or a side of more than a million pixels. Raises `OSError` if the file cannot be
    written.
    """
    target = check_named("file", file_named(".png"), file)
    content = png_of(pixels)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(content)


@name_wrong_arguments
def png_of(pixels: NDArray[np.integer]) -> bytes:
    """Encodes a picture as a PNG file.

    The picture is ``[H, W]``, in RGB ``[H, W, 3]``, or with opacity ``[H, W, 4]``. Raises
    `InputError` for values that are not uint8 or uint16, another shape, no pixel, or a side of more
    than a million pixels.
    """
    pixels = np.asarray(pixels)
    if (
        pixels.dtype not in (np.uint8, np.uint16)
        or not pixels.size
        or pixels.ndim < 2
        or pixels.shape[2:] not in ((), (3,), (4,))
    ):
        raise InputError(
            "pixels",
            "uint8 or uint16 [H, W], [H, W, 3] or [H, W, 4]",
            f"{pixels.dtype} {list(pixels.shape)}",
        )
    if max(pixels.shape) > _LONGEST_PNG:
        raise InputError("pixels", f"at most {_LONGEST_PNG:,} pixels a side", list(pixels.shape))
    if pixels.ndim == 3:
        # OpenCV writes blue first.
        swap = cv2.COLOR_RGB2BGR if pixels.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
        pixels = np.asarray(cv2.cvtColor(pixels, swap), pixels.dtype)
    return cv2.imencode(".png", pixels)[1].tobytes()


@name_wrong_arguments
def standing_objects(
    objects: Sequence[MapObject] | None, pictures: ObjectSet | str | Path | None = None
) -> list[Standing]:
    """Returns how objects look from their front, for the floors of 3-D simulators.

    Tags on the floor are left out.

    Args:
      objects: the objects of a map; None is no object.
      pictures: the pictures of objects, a set or its folder; by default the package's own. `render`
        chooses the same ones.

    Returns:
      A record for each object, for `to_gltf`, `to_mjcf` and `to_usd`: `thing`, the `MapObject`;
      `picture`, a PNG file with transparency, from the floor to the object's height; `width`, that
      of the picture in metres; and `colour`, the mean red, green and blue of its opaque pixels, 0
      to 1.

    Raises:
      InputError: for anything else, or a kind without pictures in the set.
    """
    objects = check_named("objects", listed(MapObject), objects or ())
    standing = []
    for thing, chosen in zip(objects, load_objects(pictures).choose(objects), strict=True):
        if thing.height:
            front = chosen.views[0]
            width = thing.height * front.shape[1] / front.shape[0]
            red, green, blue = (front[front[..., 3] >= OPAQUE][:, :3].mean(axis=0) / 255).tolist()
            standing.append(Standing(thing, png_of(front), width, (red, green, blue)))
    return standing


@name_wrong_arguments
@lru_cache(maxsize=4)
def scale_tiles(tiles: TileSet, size: int) -> dict[str, NDArray[np.uint8]]:
    """Scales all layers of all T tiles of a set in all four rotations to P = `size` pixels a side.

    Returns:
      uint8 ``[4·T, P, P]`` and for "image" ``[4·T, P, P, 3]``, by name: image, road, red, yellow
      and labels. Index ``4·t + q`` is tile t, turned counter-clockwise by q quarters. The arrays
      are read-only: all calls with the same tiles and size share them.

    Raises:
      InputError: for anything else than a tile set, or a size that is not a whole number from 1 on.
    """
    check_named("size", whole(1), size)
    layers: dict[str, list[NDArray[np.uint8]]] = {}
    for tile in tiles.pictures:
        masks = {name: _resize_mask(getattr(tile, name), size, name) for name in MASKS}
        # Separators cover stop lines, and both cover the road, whose mask is its label, 1.
        labels = np.where(masks["yellow"], 3, np.where(masks["red"], 2, masks["road"])).astype(
            np.uint8
        )
        drawn = {name: mask * np.uint8(255) for name, mask in masks.items()}
        for name, layer in (drawn | {"image": _resize(tile.image, size), "labels": labels}).items():
            layers.setdefault(name, []).extend(np.rot90(layer, turns) for turns in range(4))
    scaled = {name: np.stack(rotated) for name, rotated in layers.items()}
    for layer in scaled.values():
        layer.flags.writeable = False
    return scaled


def show_paved(tiles: TileSet, chosen: NDArray[np.int_], tile_px: int) -> NDArray[np.bool_]:
    """Returns where a map shows its tiles and not the ground, bool ``[H·P, W·P]``.

    Empty cells and the transparent pixels of tile pictures are ground. `chosen` is what
    `choose_tiles` returns.
    """
    return _lay_out(scale_opaque(tiles, tile_px), chosen[..., 0] * 4 + chosen[..., 1])


@lru_cache(maxsize=4)
def scale_opaque(tiles: TileSet, size: int) -> NDArray[np.bool_]:
    """Scales where all tiles are opaque, bool ``[4·T, P, P]``, with indices as in `scale_tiles`."""
    rotated = []
    for tile in tiles.pictures:
        opaque = np.ones(tile.road.shape, bool) if tile.opaque is None else tile.opaque
        scaled = _resize_mask(opaque, size, "opaque")
        rotated += [np.rot90(scaled, turns) for turns in range(4)]
    return np.stack(rotated)


def _resize(picture: np.ndarray, size: int) -> np.ndarray:
    if picture.shape[0] == size:
        return picture
    shrinks = size < picture.shape[0]
    return cv2.resize(
        picture, (size, size), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    )


def _resize_mask(mask: NDArray[np.bool_], size: int, name: str) -> NDArray[np.bool_]:
    """Scales a mask: it keeps the pixels that it covers by half or more.

    Lines that are about as thin as a pixel would then grow or vanish at some sizes. If a line's
    area would change by more than a third, the most covered pixels are kept instead, as many as its
    area. Equally covered pixels are kept together. So each class keeps its share of the picture,
    unless it is a straight line along a tile's side: that stays a line.
    """
    cover = _resize(mask.astype(np.float32), size)
    half, area = cover >= 0.5, round(float(cover.sum()))
    if name not in ("red", "yellow") or not area or 0.75 * area <= half.sum() <= 1.33 * area:
        return half
    # Rounding would tell equally covered pixels apart without the tolerance.
    return cover >= np.sort(cover, axis=None)[-area] - 1e-4


def _lay_out(scaled: NDArray[_L], picture: NDArray[np.int_]) -> NDArray[_L]:
    """Lays some of the pictures ``[T, P, P, ...]`` side by side, ``[H·P, W·P, ...]``."""
    (height, width), (size, _, *channels) = picture.shape, scaled.shape[1:]
    layer = np.empty((height * size, width * size, *channels), scaled.dtype)
    for row, column in np.ndindex(height, width):
        cell = layer[row * size : (row + 1) * size, column * size : (column + 1) * size]
        cell[:] = scaled[picture[row, column]]
    return layer

"""The files of a folder of maps: each map with its picture and its masks, and a sheet with all of them."""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named
from elitelanes_jax._util.files import read_json
from elitelanes_jax._util.folders import foreign_file
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.threads import count_cores, side_by_side
from elitelanes_jax.formats.road_map import Drawn, RoadMap
from elitelanes_jax.maps.furnishing.placing import furnish as furnish_map
from elitelanes_jax.maps.furnishing.spec import FurnishSpec
from elitelanes_jax.problem.inventory import COUNTED
from elitelanes_jax.tiles.contact_sheet import contact_sheet, pin_signs
from elitelanes_jax.tiles.rendering import choose_tiles, render, write_picture, write_png
from elitelanes_jax.tiles.tileset import MASKS, TileSet

ARCHIVE = "archive.npz"
"""The file with the elites of all seeds of a run or a part."""

RECORD = "run.json"
"""The file with the settings of a run, a part or a choice."""

# The longer side of a map on the contact sheet, in pixels, and the range of a tile's side.
_SHEET_PX, _SHEET_TILE_PX = 288, (16, 96)
# The same of maps with objects: at 72 pixels a tile one can read the signs.
_SIGNS_PX, _SIGNS_TILE_PX = 1152, 72

# The files of a rendered map. A map with objects also has instances.png.
_PICTURES = tuple(f"{name}.png" for name in ("image", *MASKS, "labels"))


class Drawing(NamedTuple):
    """How the maps of a folder are drawn.

    Attributes:
      tiles: the tile pictures.
      tile_px: the side of a tile in pixels.
      seed: of the choice of tile pictures, and of the positions of objects.
      furnish: the objects of the maps; None if maps keep the objects that they have.
    """

    tiles: TileSet
    tile_px: int
    seed: int
    furnish: FurnishSpec | None = None


def write_maps(folder: Path, maps: Sequence[RoadMap], title: str, drawing: Drawing) -> list[RoadMap]:
    """Writes each map to its own folder, ``maps/0000`` and so on, and the contact sheet; returns the maps as drawn.

    The maps have one size, and metrics. Raises `InputError` if the objects do not fit on a map.
    """
    if drawing.furnish is not None:
        place = partial(furnish_map, spec=drawing.furnish, seed=drawing.seed, lane_offset=drawing.tiles.lane_offset)
        maps = [check_named(f"furnish: map {index}", place, plain) for index, plain in enumerate(maps)]
    longest = max(maps[0].codes.shape)
    sheet_px = int(np.clip(_SHEET_PX // longest, *_SHEET_TILE_PX))
    has_objects = any(road_map.objects for road_map in maps)
    if has_objects:
        sheet_px = int(np.clip(_SIGNS_PX // longest, sheet_px, _SIGNS_TILE_PX))

    def draw(index: int, plain: RoadMap) -> tuple[RoadMap, NDArray[np.uint8]]:
        tiles = drawing.tiles
        chosen = choose_tiles(plain.codes, tiles, [drawing.seed, index])
        names = [[tiles.pictures[tile].name for tile, _ in row] for row in chosen]
        road_map = replace(plain, drawn=Drawn(tiles.name, names, chosen[..., 1].tolist()))
        path = folder / "maps" / f"{index:04d}"
        path.mkdir(parents=True)
        write_picture(path, render(plain, tiles, tile_px=drawing.tile_px, chosen=chosen))
        road_map.save(path / "map.json")
        small = render(plain, tiles, tile_px=sheet_px, chosen=chosen).image
        if has_objects:
            small = pin_signs(small, plain.objects or (), sheet_px)
        return road_map, small

    with Progress("drawing", len(maps), "maps") as bar:
        calls = [partial(draw, index, plain) for index, plain in enumerate(maps)]
        drawn = side_by_side(calls, workers=count_cores(), ended=lambda _: bar.count())
    captions = [_caption(index, road_map) for index, (road_map, _) in enumerate(drawn)]
    sheet = contact_sheet(title, [image for _, image in drawn], captions)
    write_png(folder / "contact-sheet.png", sheet)
    return [road_map for road_map, _ in drawn]


def foreign_to_maps(folder: Path) -> str | None:
    """Returns the first file in a folder that `generate` and `pick` did not write, or None."""
    try:
        run = read_json(folder / RECORD)
        if "elitelanes_jax" not in run["versions"]:
            return f"{RECORD} of another program"
    except FileNotFoundError:
        return f"no {RECORD}"
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return f"{RECORD} of another program"
    names = "|".join(map(re.escape, ("map.json", *_PICTURES, "instances.png")))
    own = re.compile(rf"run\.json|archive\.npz|explore\.html|contact-sheet\.png|maps/\d{{4,}}/({names})")
    return foreign_file(folder, own.fullmatch)


def foreign_to_picture(folder: Path) -> str | None:
    """Returns the first file in a folder that `render` did not write, or None."""
    names = {*_PICTURES, "instances.png", "overlay.png"}
    missing = [name for name in _PICTURES if not (folder / name).is_file()]
    return foreign_file(folder, names.__contains__) or (f"no {missing[0]}" if missing else None)


def _caption(index: int, road_map: RoadMap) -> tuple[str, ...]:
    metrics = road_map.metrics or {}
    used = [(kind, metrics[name], metrics.get(f"{name}_left")) for kind, name in COUNTED.items() if name in metrics]
    shelf = ", ".join(f"{kind} {count} of {count + left}" for kind, count, left in used if left is not None)
    return (
        f"{index:04d}   fitness {road_map.fitness}",
        f"cyclomatic {metrics['cyclomatic']}, crossings {metrics['crossings']}, bridges {metrics['bridges']}",
        f"adjacent: crossings {metrics['adjacent_crossings']}, turns {metrics['adjacent_turns']}; "
        f"straight {metrics['straight_score']}",
        *([f"used: {shelf}"] if shelf else []),
    )

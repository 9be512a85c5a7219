"""The files of a folder of maps.

Each map has a picture and masks, and a sheet shows all maps.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple, NotRequired, TypedDict, cast

import numpy as np
from jaxtyping import UInt8

from elitelanes_jax._util.checks import check_named
from elitelanes_jax._util.files import read_json
from elitelanes_jax._util.folders import foreign_file
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.threads import count_cores, side_by_side
from elitelanes_jax._util.types import OptionValue, Plain, Untyped
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.faults import announce_without_room
from elitelanes_jax.maps.furnishing.placing import furnish as furnish_map
from elitelanes_jax.maps.furnishing.spec import FurnishSpec
from elitelanes_jax.problem.inventory import COUNTED
from elitelanes_jax.tiles.contact_sheet import contact_sheet, pin_signs
from elitelanes_jax.tiles.rendering import choose_tiles, record_choice, render, write_png
from elitelanes_jax.tiles.tileset import MASKS, TileSet

ARCHIVE = "archive.npz"
"""The file with the elites of all seeds of a run or a part."""

RECORD = "run.json"
"""The file with the settings of a run, a part or a choice."""

# The longer side of a map on the contact sheet in pixels, and the least and the largest side of a
# tile there.
_SHEET_PX, _SHEET_TILE_PX = 288, (16, 96)
# The longer side of a map with objects, and the largest side of its tiles. At 72 pixels a tile one
# can read the signs.
_SIGNS_PX, _SIGNS_TILE_PX = 1152, 72

# The pictures of a rendered map. A map with objects also has instances.png.
_PICTURES = tuple(f"{name}.png" for name in ("image", *MASKS, "labels"))


class Drawing(NamedTuple):
    """How the maps of a folder are drawn.

    Attributes:
      tiles: the tile pictures.
      tile_px: the side of a tile in pixels.
      seed: the seed of the choice of tile pictures, and of the positions of objects.
      furnish: the objects of the maps; None if maps keep the objects that they have.
    """

    tiles: TileSet
    tile_px: int
    seed: int
    furnish: FurnishSpec | None = None


def write_maps(
    folder: Path, maps: Sequence[RoadMap], title: str, drawing: Drawing
) -> list[RoadMap]:
    """Writes each map to its own folder, and the contact sheet; returns the maps as drawn.

    The folders are ``maps/0000`` and so on. The maps have one size, and metrics. Raises
    `InputError` if the objects do not fit on a map.
    """
    if drawing.furnish is not None:
        place = partial(
            furnish_map,
            spec=drawing.furnish,
            seed=drawing.seed,
            lane_offset=drawing.tiles.lane_offset,
        )
        furnished = []
        for index, plain in enumerate(maps):
            furnished.append(check_named(f"furnish: map {index}", place, plain))
        maps = furnished
        announce_without_room(maps, drawing.furnish)
    # Objects are placed first, because maps with objects need a larger sheet.
    sheet_px = _choose_sheet_px(maps)
    draw = partial(_draw_map, folder / "maps", drawing, sheet_px)
    with Progress("drawing", len(maps), "maps") as bar:
        calls = [partial(draw, index, plain) for index, plain in enumerate(maps)]
        # Maps are drawn in several threads. Results are in the order of the maps.
        drawn = side_by_side(calls, workers=count_cores(), ended=lambda _: bar.count())
    road_maps = [road_map for road_map, _ in drawn]
    captions = [_caption(index, road_map) for index, road_map in enumerate(road_maps)]
    sheet = contact_sheet(title, [picture for _, picture in drawn], captions)
    write_png(folder / "contact-sheet.png", sheet)
    return road_maps


class _SheetSize(NamedTuple):
    """The side of a tile on the contact sheet, and whether signs are pinned there."""

    tile_px: int
    has_objects: bool


def _choose_sheet_px(maps: Sequence[RoadMap]) -> _SheetSize:
    longest = max(maps[0].codes.shape)
    least, most = _SHEET_TILE_PX
    tile_px = min(max(_SHEET_PX // longest, least), most)
    has_objects = any(road_map.objects for road_map in maps)
    if has_objects:
        tile_px = min(max(_SIGNS_PX // longest, tile_px), _SIGNS_TILE_PX)
    return _SheetSize(tile_px, has_objects)


def _draw_map(
    folder: Path, drawing: Drawing, sheet: _SheetSize, index: int, plain: RoadMap
) -> tuple[RoadMap, UInt8[np.ndarray, "_ _ 3"]]:
    """Writes the files of a map; returns the map as drawn, and its picture on the contact sheet."""
    tiles = drawing.tiles
    # The seed and the index of the map choose the pictures, so the order of the threads does not
    # matter.
    chosen = choose_tiles(plain.codes, tiles, [drawing.seed, index])
    road_map = replace(plain, drawn=record_choice(tiles, chosen))
    map_folder = folder / f"{index:04d}"
    map_folder.mkdir(parents=True)
    render(plain, tiles, tile_px=drawing.tile_px, chosen=chosen).save(map_folder)
    road_map.save(map_folder / "map.json")
    # The map on the sheet has the same tile pictures, drawn at another size.
    small = render(plain, tiles, tile_px=sheet.tile_px, chosen=chosen).image
    if sheet.has_objects:
        small = pin_signs(small, plain.objects or (), sheet.tile_px)
    return road_map, small


class RunTimes(TypedDict):
    """The seconds of a run by stage, and its speed; None for a run without generations."""

    seconds: dict[str, float]
    evaluations_per_second: float | None


class RunRecord(TypedDict):
    """The fields of `RECORD` that the package reads. That of `pick` lacks the last four."""

    versions: dict[str, str]
    tile_set: Plain
    settings: dict[str, OptionValue]
    archive: NotRequired[Plain]
    device: str
    times: RunTimes


def read_run_record(folder: Path) -> RunRecord:
    """Reads the record of a folder of maps; see `read_json` for the errors.

    The fields are not checked. One that is missing or wrong raises a `KeyError` or `TypeError`.
    """
    return cast("RunRecord", read_json(folder / RECORD))


def foreign_to_maps(folder: Path) -> str | None:
    """Returns the first file in a folder that `generate` and `pick` did not write, or None."""
    # These are all files that `generate`, `pick` and `explore` write into such a folder.
    map_files = "|".join(map(re.escape, ["map.json", *_PICTURES, "instances.png"]))
    written = (
        rf"run\.json|archive\.npz|explore\.html|contact-sheet\.png|maps/\d{{4,}}/({map_files})"
    )
    return foreign_to_record(folder, RECORD, lambda _: written)


def foreign_to_record(
    folder: Path, record_name: str, pattern_of: Callable[[Untyped], str]
) -> str | None:
    """Returns the first file that the package did not write into a folder with a record, or None.

    `pattern_of` takes the content of the record, and returns a regular expression of the paths of
    all files that the package writes there.
    """
    another = f"{record_name} of another program"
    try:
        record: Untyped = read_json(folder / record_name)
        if "elitelanes_jax" not in record["versions"]:
            return another
        written = re.compile(pattern_of(record))
    except FileNotFoundError:
        return f"no {record_name}"
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return another
    return foreign_file(folder, written.fullmatch)


def foreign_to_picture(folder: Path) -> str | None:
    """Returns the first file in a folder that `render` did not write, or None."""
    names = {*_PICTURES, "instances.png", "overlay.png"}
    foreign = foreign_file(folder, names.__contains__)
    if foreign is not None:
        return foreign
    for name in _PICTURES:
        if not (folder / name).is_file():
            return f"no {name}"
    return None


def _caption(index: int, road_map: RoadMap) -> tuple[str, ...]:
    metrics = road_map.metrics or {}
    lines = [
        f"{index:04d}   fitness {road_map.fitness}",
        f"cyclomatic {metrics['cyclomatic']}, crossings {metrics['crossings']}, "
        f"bridges {metrics['bridges']}",
        f"adjacent: crossings {metrics['adjacent_crossings']}, turns {metrics['adjacent_turns']}; "
        f"straight {metrics['straight_score']}",
    ]
    # A search with an inventory also measures how many tiles of each kind are left.
    used = []
    for kind, name in COUNTED.items():
        if f"{name}_left" in metrics:
            count, left = metrics[name], metrics[f"{name}_left"]
            used.append(f"{kind} {count} of {count + left}")
    if used:
        lines.append(f"used: {', '.join(used)}")
    return tuple(lines)

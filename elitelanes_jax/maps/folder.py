"""The files of a folder of maps: each map with its picture and its masks, and a sheet with all of them."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from elitelanes_jax._util.files import read_json
from elitelanes_jax._util.folders import foreign_file
from elitelanes_jax._util.progress import Progress
from elitelanes_jax.formats.road_map import Drawn, RoadMap, map_to_json
from elitelanes_jax.tiles.contact_sheet import contact_sheet
from elitelanes_jax.tiles.rendering import choose_tiles, render, write_picture, write_png
from elitelanes_jax.tiles.tileset import MASKS, TileSet

# A map's longer side on the contact sheet, in pixels, and the limits of a tile's.
_SHEET_PX, _SHEET_TILE_PX = 288, (16, 96)


def write_maps(
    folder: Path, maps: Sequence[RoadMap], title: str, tiles: TileSet, *, tile_px: int, seed: int
) -> list[RoadMap]:
    """Writes each map in a folder of its own, ``maps/0000`` and so on, and the contact sheet.

    Args:
      folder: to write in.
      maps: of one size, with their metrics.
      title: of the sheet.
      tiles: to draw them with.
      tile_px: side of a tile in pixels.
      seed: of the choice of tile pictures.

    Returns:
      The maps as they were drawn.

    Raises:
      OSError: if a file cannot be written.
    """
    sheet_px = int(np.clip(_SHEET_PX // max(maps[0].codes.shape), *_SHEET_TILE_PX))
    drawn, small = [], []
    with Progress("drawing", len(maps), "maps") as bar:
        for number, plain in enumerate(maps):
            chosen = choose_tiles(plain.codes, tiles, [seed, number])
            names = [[tiles.pictures[tile].name for tile, _ in row] for row in chosen]
            road_map = replace(plain, drawn=Drawn(tiles.name, names, chosen[..., 1].tolist()))
            place = folder / "maps" / f"{number:04d}"
            place.mkdir(parents=True)
            write_picture(place, render(plain.codes, tiles, tile_px=tile_px, chosen=chosen))
            (place / "map.json").write_text(map_to_json(road_map), encoding="utf-8")
            small.append(render(plain.codes, tiles, tile_px=sheet_px, chosen=chosen).image)
            drawn.append(road_map)
            bar.count()
    sheet = contact_sheet(title, small, [_caption(number, road_map) for number, road_map in enumerate(drawn)])
    write_png(folder / "contact-sheet.png", sheet)
    return drawn


def foreign_to_maps(folder: Path) -> str | None:
    """Returns the first file in a folder that `generate` and `pick` did not write there; None without one."""
    try:
        run = read_json(folder / "run.json")
        names = "|".join(map(re.escape, ("map.json", *_picture_files(run["tile_set"].get("layers", ())))))
        if "elitelanes_jax" not in run["versions"]:
            return "run.json of another program"
    except FileNotFoundError:
        return "no run.json"
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return "run.json of another program"
    own = re.compile(rf"run\.json|archive\.npz|explore\.html|contact-sheet\.png|maps/\d{{4,}}/({names})")
    return foreign_file(folder, own.fullmatch)


def foreign_to_picture(layers: Iterable[str]) -> Callable[[Path], str | None]:
    """Makes a function from a folder to its first file that is none of a picture of a tile set with such layers."""
    names = {*_picture_files(layers), "overlay.png"}

    def foreign(folder: Path) -> str | None:
        missing = [name for name in _picture_files(()) if name != "points.json" and not (folder / name).is_file()]
        return foreign_file(folder, names.__contains__) or (f"no {missing[0]}" if missing else None)

    return foreign


def _picture_files(layers: Iterable[str]) -> list[str]:
    return [*(f"{name}.png" for name in ("image", *MASKS, "labels", *layers)), "points.json"]


def _caption(number: int, road_map: RoadMap) -> tuple[str, ...]:
    figures = road_map.metrics or {}
    return (
        f"{number:04d}   fitness {road_map.fitness}",
        f"cyclomatic {figures['cyclomatic']}, crossings {figures['crossings']}, bridges {figures['bridges']}",
        f"adjacent: crossings {figures['adjacent_crossings']}, turns {figures['adjacent_turns']}; "
        f"straight {figures['straight_score']}",
    )

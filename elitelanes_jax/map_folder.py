"""The files of a folder of maps: each map with its picture and its masks, and a sheet with all of them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from elitelanes_jax._util.progress import Progress
from elitelanes_jax.formats.road_map import Drawn, RoadMap, map_to_json
from elitelanes_jax.tiles.contact_sheet import contact_sheet
from elitelanes_jax.tiles.render import choose_tiles, render, write_picture, write_png
from elitelanes_jax.tiles.tileset import TileSet

__all__ = ["write_maps"]

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
            road_map = plain._replace(drawn=Drawn(tiles.name, names, chosen[..., 1].tolist()))
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


def _caption(number: int, road_map: RoadMap) -> tuple[str, ...]:
    figures = road_map.metrics or {}
    return (
        f"{number:04d}   fitness {road_map.fitness}",
        f"cyclomatic {figures['cyclomatic']}, crossings {figures['crossings']}, bridges {figures['bridges']}",
        f"adjacent: crossings {figures['adjacent_crossings']}, turns {figures['adjacent_turns']}; "
        f"straight {figures['straight_score']}",
    )

"""The payload of the explorer: values for JSON, and one blob of arrays, compressed."""

import base64
import json
import zlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.packages import __version__
from elitelanes_jax._util.types import ArrayOrRows, Plain
from elitelanes_jax.explorer._shown import ShownRun
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.objects import OBJECT_KINDS, object_values
from elitelanes_jax.formats.plan import LONGEST_PLAN
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.tags import SIGN_TAGS, STREETS
from elitelanes_jax.formats.tapes import REFERENCE, TAPE_WIDTHS, tapes_of
from elitelanes_jax.network.records import Weights
from elitelanes_jax.problem.archive import vacant_fitness
from elitelanes_jax.tiles.object_set import load_objects
from elitelanes_jax.tiles.rendering import COMPARED_PX, png_of, recall_choice, scale_tiles
from elitelanes_jax.tiles.tileset import TileSet

if TYPE_CHECKING:
    from elitelanes_jax.search.records import History

_FORMAT = "elitelanes explorer, version 1"

# Steps of a history that are kept: the width of a chart in pixels.
_MOST_STEPS = 400

# The least number of random numbers that choose tile pictures, so that maps up to 64 x 64 look as
# `render` draws them.
_LEAST_LOTS = 4096


class Payload(NamedTuple):
    """The contents of the explorer.

    Attributes:
      values: values for JSON. A table ``{"array": [dtype, start, count]}`` represents an array: its
        little-endian numbers start at that byte of the blob.
      blob: the arrays, one after another, compressed by zlib.
    """

    values: dict[str, Plain]
    blob: bytes


class _Blob:
    """The bytes of arrays, one after another."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def add(self, array: ArrayOrRows, dtype: str) -> dict[str, Plain]:
        """Adds an array; returns the table that represents it."""
        # The page reads little-endian numbers on all machines.
        content = np.ascontiguousarray(array, np.dtype(dtype).newbyteorder("<")).tobytes()
        start = self._size
        # Every array starts at a multiple of 8 bytes, as the browser's typed arrays need.
        padding = -len(content) % 8
        self._parts += [content, bytes(padding)]
        self._size += len(content) + padding
        return {"array": [dtype, start, len(content) // np.dtype(dtype).itemsize]}

    def add_codes(self, grids: NDArray[np.int8]) -> dict[str, Plain]:
        """Adds tile codes, two per byte, the first in the lower half.

        Returns the table that represents them.
        """
        flat = grids.reshape(-1).astype(np.uint8)
        # An odd number of codes leaves half a byte.
        flat = np.pad(flat, (0, flat.size % 2))
        return self.add(flat[::2] | flat[1::2] << 4, "uint8") | {"codes": grids.size}

    def add_json(self, values: Plain) -> dict[str, Plain]:
        """Adds values as the bytes of their JSON, which pack well.

        Returns the table that represents them.
        """
        return self.add(
            np.frombuffer(json.dumps(values, separators=(",", ":")).encode(), np.uint8), "uint8"
        )

    def packed(self) -> bytes:
        # The level of compression is the highest one, because a page is written once.
        return zlib.compress(b"".join(self._parts), 9)


def make_payload(runs: Sequence[ShownRun], tiles: TileSet, tile_px: int, title: str) -> Payload:
    blob = _Blob()
    # A map of this size needs a random number for each of its cells.
    cells = max(run.grids[0].size for run in runs)
    values: dict[str, Plain] = {
        "format": _FORMAT,
        "version": __version__,
        "title": title,
        "tiles": _tile_values(tiles, tile_px),
        "objects": _object_values(),
        "plan": plan_values(),
        "default_weights": Weights()._asdict(),
        # The first numbers that `choose_tiles` and `ObjectSet.choose` draw for seed 0.
        # The page draws edited maps as `render` would, and cannot run NumPy's generator.
        "lots": blob.add(np.random.default_rng(0).random(max(cells, _LEAST_LOTS)), "float64"),
        "runs": [_run_values(run, tiles, blob) for run in runs],
    }
    return Payload(values, blob.packed())


def _run_values(run: ShownRun, tiles: TileSet, blob: _Blob) -> dict[str, Plain]:
    # Arrays go into the blob, and all else into the page's JSON.
    return {
        "name": run.name,
        "shape": list(run.grids.shape[1:]),
        "seeds": run.seeds,
        "axes": [axis._asdict() for axis in run.axes],
        "weights": {name: int(weight) for name, weight in run.weights.items()},
        "alphabet": None if run.alphabet is None else sorted({int(code) for code in run.alphabet}),
        "grids": blob.add_codes(run.grids),
        "fitness": None if run.fitness is None else blob.add(run.fitness, run.fitness.dtype.name),
        "seed": blob.add(run.seed, "int32"),
        "niche": None if run.niche is None else blob.add(run.niche, "int32"),
        "features": {name: blob.add(values, "int32") for name, values in run.features.items()},
        "labels": run.labels,
        "maps": [
            _map_values(elite, name, road_map, tiles, blob) for elite, name, road_map in run.maps
        ],
        "history": None if run.history is None else _history_values(run.history, blob),
        "usual_fitness": run.usual_fitness,
        "floors": None if run.floors is None else list(run.floors.items()),
        "record": run.record,
    }


def _map_values(
    elite: int, name: str, road_map: RoadMap, tiles: TileSet, blob: _Blob
) -> dict[str, Plain]:
    """Returns a chosen map: its elite, its objects, and its tile pictures.

    A tile picture is its index times 4, plus its quarter turns.
    """
    chosen = recall_choice(road_map, tiles)
    # Without a recorded choice, the page chooses pictures by its random numbers.
    pictures = None
    if chosen is not None:
        pictures = (chosen[..., 0] * 4 + chosen[..., 1]).ravel().tolist()
    objects = None
    if road_map.objects:
        objects = blob.add_json([object_values(item) for item in road_map.objects])
    return {"elite": elite, "name": name, "pictures": pictures, "objects": objects}


def _history_values(history: "History", blob: _Blob) -> dict[str, Plain] | None:
    count = len(history.generation)
    if count == 0:
        return None
    # More steps than pixels would not be seen. The first and the last step are always kept.
    steps = np.unique(np.linspace(0, count - 1, min(count, _MOST_STEPS)).round().astype(int))
    # The page reads a row for each seed.
    best = history.best_fitness[:, steps]
    elites = history.elite_count[:, steps]
    # The fitness of a vacant slot is not the fitness of a grid.
    best = np.where(best == vacant_fitness(best.dtype), np.inf, best)
    return {
        "steps": len(steps),
        "evaluations": blob.add(history.evaluations[steps], "float64"),
        "best_fitness": blob.add(best, "float64"),
        "elite_count": blob.add(elites, "int32"),
    }


def _tile_values(tiles: TileSet, tile_px: int) -> dict[str, Plain]:
    """Returns each tile picture once, and whether the page blends them."""
    pictures: list[dict[str, Plain]] = []
    for tile, layers in zip(tiles.pictures, _layers(tiles, tile_px), strict=True):
        about = {"name": tile.name, "code": int(tile.code)}
        # The bare ground of empty cells has no digest.
        digest = tiles.picture_digests.get(tile.name)
        pictures.append(about | ({"digest": digest} if digest else {}) | layers)
    # `render` compares the light of blended tiles at this size, so the page needs their pictures at
    # it.
    if tiles.blend and tile_px != COMPARED_PX:
        for picture, layers in zip(pictures, _layers(tiles, COMPARED_PX), strict=True):
            picture["compared"] = layers
    # A picture and its quarter turns are one number, as in `_map_values`.
    rotations = {}
    for code, draws in tiles.rotations.items():
        rotations[str(code)] = [4 * tile + turns for tile, turns in draws]
    return {
        "name": tiles.name,
        "px": tile_px,
        "blend": tiles.blend,
        "pictures": pictures,
        "rotations": rotations,
    }


def _layers(tiles: TileSet, tile_px: int) -> list[dict[str, Plain]]:
    """Returns each tile's picture as PNG, and its masks.

    The masks are bits of grey values: 1 road, 2 red, 4 yellow.
    """
    layers = scale_tiles(tiles, tile_px)
    pictures: list[dict[str, Plain]] = []
    # The page turns pictures by itself, so only the first of four rotations is sent.
    for upright in range(0, 4 * len(tiles.pictures), 4):
        masks = (layers["road"][upright] > 0).astype(np.uint8)
        masks |= (layers["red"][upright] > 0) * np.uint8(2)
        masks |= (layers["yellow"][upright] > 0) * np.uint8(4)
        pictures.append({"image": _data_url(layers["image"][upright]), "masks": _data_url(masks)})
    return pictures


def _object_values() -> dict[str, Plain]:
    """Returns the size of each kind of object, the tag numbers of signs, and pictures.

    The pictures show objects from above.
    """
    by_kind: dict[str, Plain] = {}
    for kind, pictures in load_objects().kinds.items():
        shown: list[dict[str, Plain]] = []
        for picture in pictures:
            image = _data_url(picture.top)
            # Height and footprint tell the page how large to draw the picture.
            shown.append({"image": image, "height": picture.height, "footprint": picture.footprint})
        by_kind[kind] = shown
    return {
        "kinds": dict(OBJECT_KINDS),
        "tags": dict(SIGN_TAGS),
        "streets": STREETS,
        "pictures": by_kind,
    }


def plan_values() -> dict[str, Plain]:
    """Returns the tapes of each kind of tile, so that the page can write a plan."""
    kinds = {}
    for kind, code in REFERENCE.items():
        tapes = []
        for tape in tapes_of(kind, 0):
            # The length is not rounded, so that the page's bill is that of `make_plan`.
            tapes.append([tape.colour, np.round(tape.points, 6).tolist(), tape.length])
        kinds[kind] = {"code": code, "tapes": tapes}
    return {
        "tile_size": TILE_SIZE,
        "longest": LONGEST_PLAN,
        "widths": dict(TAPE_WIDTHS),
        "kinds": kinds,
    }


def _data_url(pixels: NDArray[np.uint8]) -> str:
    return "data:image/png;base64," + base64.b64encode(png_of(pixels)).decode()

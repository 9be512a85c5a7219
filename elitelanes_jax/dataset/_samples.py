"""Samples: what they have in common, and what each of them has."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._transforms import Transforms
from elitelanes_jax.dataset._views import DrawnTransform
from elitelanes_jax.dataset.tables import SampleRecord
from elitelanes_jax.drive.camera_options import LaneCamera
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.tiles.object_set import ObjectSet
from elitelanes_jax.tiles.packed import Pictures
from elitelanes_jax.tiles.rendering import LABELS, TileChoice, plan_choice, png_of
from elitelanes_jax.tiles.tileset import TileSet


class Sample(NamedTuple):
    """A drawn sample.

    Attributes:
      layers: the layers by name: image, uint8 ``[h, w, 3]``; labels, uint8 ``[h, w]``; with an
        object set also instances, uint16 ``[h, w]``.
      record: the metadata of the sample, plain values for JSON.
    """

    layers: dict[str, NDArray[np.integer]]
    record: SampleRecord

    def pictures(self) -> dict[str, bytes]:
        """Returns the layers as files of PNG, by name."""
        return {name: png_of(layer) for name, layer in self.layers.items()}


def layer_names(*, has_objects: bool) -> tuple[str, ...]:
    """Returns the names of a sample's layers, those of `Sample.layers`."""
    return ("image", "labels", "instances") if has_objects else ("image", "labels")


@dataclass(frozen=True)
class SampleSettings:
    """What all samples of a dataset have in common.

    Attributes:
      pictures: the tile set to draw maps with, and the object set; without one, objects are left
        out.
      seed: the seed of the dataset.
      tile_px: side of a tile in pixels.
      transforms: the ranges of views.
      camera: the camera of robots; None for views from above.
    """

    pictures: Pictures
    seed: int
    tile_px: int
    transforms: Transforms
    camera: LaneCamera | None

    @property
    def tiles(self) -> TileSet:
        """The tile set."""
        return self.pictures.tiles

    @property
    def objects(self) -> ObjectSet | None:
        """The object set; None to leave objects out."""
        return self.pictures.objects


def choose_pictures(settings: SampleSettings, road_map: RoadMap, index: int) -> NDArray[np.int_]:
    """Chooses the tiles that show the cells of a sample's map, see `choose_tiles`."""
    codes = road_map.codes
    choice = _plan_choice(codes.tobytes(), codes.shape, settings.tiles)
    # Each purpose has random numbers of its own, by the last number of its seed. Therefore no
    # choice changes another one.
    return choice.choose([settings.seed, index])


@lru_cache(maxsize=64)
def _plan_choice(codes: bytes, shape: tuple[int, int], tiles: TileSet) -> TileChoice:
    """Lists the pictures of a map's cells, once for all views of the map."""
    return plan_choice(np.frombuffer(codes, np.int8).reshape(shape), tiles)


def describe(
    settings: SampleSettings,
    road_map: RoadMap,
    chosen: NDArray[np.int_],
    view: DrawnTransform,
    labels: NDArray[np.uint8],
    index: int,
    about: Mapping[str, Plain],
) -> SampleRecord:
    """Returns the metadata of a sample, without entries that the map does not have.

    `chosen` is what `choose_pictures` returns.
    """
    names = [picture.name for picture in settings.tiles.pictures]
    transform = view._asdict() | {"matrix": view.matrix.tolist()}
    # The entry `pixels` has the size.
    del transform["size"]
    # Maps from files may lack metrics, fitness, a niche or a seed.
    metadata = {
        "number": index,
        "size": list(road_map.codes.shape),
        "pixels": list(view.size),
        "codes": road_map.codes.tolist(),
        "metrics": road_map.metrics,
        "fitness": road_map.fitness,
        "niche": road_map.niche,
        "map_seed": road_map.seed,
        "tiles": [[names[tile] for tile in row] for row in chosen[..., 0].tolist()],
        "quarter_turns": chosen[..., 1].tolist(),
        "transform": transform,
        **about,
        "class_pixels": [int(np.count_nonzero(labels == label)) for label in range(len(LABELS))],
    }
    present = {name: value for name, value in metadata.items() if value is not None}
    return cast("SampleRecord", present)

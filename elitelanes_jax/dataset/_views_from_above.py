"""Samples that are seen from above."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._samples import Sample, SampleSettings, choose_pictures, describe
from elitelanes_jax.dataset._transforms import Transforms
from elitelanes_jax.dataset._variation import (
    compress,
    varies,
    vary_background,
    vary_light,
    vary_motion,
)
from elitelanes_jax.dataset._views import DrawnTransform, draw_view, photograph, warp
from elitelanes_jax.dataset.tables import SeenObject
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.tiles.files import GROUND
from elitelanes_jax.tiles.object_set import lay_all_flat
from elitelanes_jax.tiles.pasting import paste_objects
from elitelanes_jax.tiles.rendering import render, show_paved


def draw_from_above(settings: SampleSettings, road_map: RoadMap, index: int) -> Sample:
    """Draws a sample: a map, warped into a view from above."""
    seed, codes, tiles, tile_px = settings.seed, road_map.codes, settings.tiles, settings.tile_px
    chosen = choose_pictures(settings, road_map, index)
    transforms, size = settings.transforms, (codes.shape[0] * tile_px, codes.shape[1] * tile_px)
    view = draw_view(np.random.default_rng([seed, index, 1]), transforms, size)
    picture = render(codes, tiles, tile_px=tile_px, chosen=chosen)
    layers = {"image": warp(picture.image, view, GROUND), "labels": warp(picture.labels, view)}
    if transforms.background:
        # The background is drawn before objects are pasted, so that it never covers them.
        paved = warp(show_paved(tiles, chosen, tile_px).astype(np.uint8), view) > 0
        behind = np.random.default_rng([seed, index, 3])
        layers["image"] = vary_background(behind, layers["image"], ~paved, transforms.background)
    about: dict[str, Plain] = {}
    instances: dict[str, NDArray[np.uint16]] = {}
    if settings.objects is not None:
        objects = road_map.objects or ()
        # From above, all objects are pictures in the plane of the map, moved by the view's matrix.
        pictures = settings.objects.choose(objects, [seed, index, 2])
        flat, order = lay_all_flat(objects, pictures, tile_px)
        placed = [item._replace(matrix=view.matrix @ item.matrix) for item in flat]
        # Arrays may be shared with the rendered map.
        layers = {name: layer.copy() for name, layer in layers.items()}
        instances["instances"], seen = paste_objects(layers, placed, order)
        listed: list[SeenObject] = []
        for number, item in zip(order, seen, strict=True):
            # Objects that are outside the view, or hidden by others, are no annotations.
            if item.visible:
                listed.append(
                    {
                        "kind": objects[number].kind,
                        "instance": number + 1,
                        "box": item.box,
                        "whole": item.whole,
                        "visible": item.visible,
                    }
                )
        about["objects"] = listed
    # Light, blur, noise and compression come last, because they change objects too.
    layers["image"] = _expose(layers["image"], view, transforms, [seed, index, 4])
    record = describe(settings, road_map, chosen, view, layers["labels"], index, about)
    return Sample({**layers, **instances}, record)


def _expose(
    image: NDArray[np.uint8], view: DrawnTransform, transforms: Transforms, seed: Sequence[int]
) -> NDArray[np.uint8]:
    """Takes a picture of what is seen.

    The picture has light and motion, the view's blur and noise, and compression.
    """
    if not varies(transforms):
        return photograph(image, view)
    rng = np.random.default_rng(seed)
    image = vary_motion(rng, vary_light(rng, image, transforms), transforms.motion)
    # Compression comes after noise, as in a camera.
    return compress(rng, photograph(image, view), transforms.compression)

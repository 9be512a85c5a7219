"""Samples that robots see on the lanes of maps.

`elitelanes_jax.drive` draws their pictures in batches. Compression comes after it, and so do blur
and motion that reach farther than the camera of `drive` draws them.
"""

from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache, partial
from operator import itemgetter
from threading import Lock

import cv2
import jax
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Numeric, OptionValue, Plain, Pytree
from elitelanes_jax.dataset._samples import Sample, SampleSettings, choose_pictures, describe
from elitelanes_jax.dataset._transforms import Transforms
from elitelanes_jax.dataset._variation import compress, vary_motion
from elitelanes_jax.dataset._views import DrawnTransform, photograph
from elitelanes_jax.dataset.tables import SeenObject
from elitelanes_jax.drive.camera_options import Camera, LaneCamera, PoseRanges, Variation
from elitelanes_jax.drive.robot import TILE
from elitelanes_jax.drive.scene_making import PackedObjects, Room, pack_scenes
from elitelanes_jax.drive.view_drawing import Plan, Scenes, draw_some
from elitelanes_jax.formats.objects import NEAR, MapObject
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.lanes.movements import movements_of
from elitelanes_jax.network.bits import seed_key
from elitelanes_jax.tiles.object_set import ObjectPictures, ObjectSet, lay_flat
from elitelanes_jax.tiles.pasting import Placed, measure_whole

BATCH = 16
"""The number of views whose numbers are drawn together.

It is always the same, so that the bits of a view do not depend on the other views.
"""

# The most pixels of the pictures that are drawn in one call, which limits the memory.
_PIXELS = 2**20
# The largest difference of the sky between the picture's upper edge and the horizon.
_HAZE = 60
# The farthest blur and motion that `drive` draws, in pixels.
_BLUR, _MOTION = 1, 2.9
# The most objects of a map, which masks of 16 bits can number.
_MOST_OBJECTS = 2**16 - 1


class RobotViews:
    """Draws what robots see of maps."""

    def __init__(self, settings: SampleSettings, maps: Collection[RoadMap]) -> None:
        """Prepares views of maps, or of furnished ones of the same codes.

        Raises:
          InputError: for a map without a lane.
        """
        assert settings.camera is not None
        if not all(movements_of(road_map.codes).row.size for road_map in maps):
            raise InputError("maps", "lanes for the camera", "a map without any")
        self._settings, self._camera = settings, settings.camera
        self._has_objects = settings.objects is not None
        self._room = Room.for_maps(maps, has_objects=self._has_objects)
        self._is_wide = settings.transforms.blur > _BLUR or settings.transforms.motion > _MOTION
        self._variation = _vary(settings.camera, settings.transforms, is_wide=self._is_wide)
        # The arrays of a call have room for as many views.
        pixels = settings.camera.rows * settings.camera.columns
        self._at_once = int(np.clip(_PIXELS // pixels, 1, BATCH))

    @runs_jax
    def draw(self, maps: Sequence[RoadMap], indices: Sequence[int]) -> list[Sample]:
        """Draws at most `BATCH` samples, each of the map at its place.

        Raises:
          InputError: for an object without a picture, or more objects than masks can number.
        """
        # Another device would draw other bits.
        with jax.default_device(jax.local_devices(backend="cpu")[0]):
            return [*self._draw(maps, indices)]

    def _draw(self, maps: Sequence[RoadMap], indices: Sequence[int]) -> Iterator[Sample]:
        views = []
        for road_map, index in zip(maps, indices, strict=True):
            views.append((road_map, index, choose_pictures(self._settings, road_map, index)))
        # The last view fills up the batch.
        filled = views + [views[-1]] * (BATCH - len(views))
        filled_maps, filled_indices, filled_chosen = zip(*filled, strict=True)
        scenes, pictures = self._pack(filled_maps, filled_indices, filled_chosen)
        for first in range(0, len(views), self._at_once):
            count = min(self._at_once, len(views) - first)
            batch = draw_some(
                seed_key(self._settings.seed),
                np.array(filled_indices, np.uint32),
                scenes,
                self._camera,
                self._variation,
                first,
                count,
                room=self._at_once,
            )
            plans, drawn = jax.device_get(batch)
            for number, view in enumerate(views[first : first + count]):
                plan = jax.tree.map(itemgetter(first + number), plans)
                yield self._finish(*view, plan, jax.tree.map(itemgetter(number), drawn), pictures)

    def _pack(
        self,
        maps: Sequence[RoadMap],
        indices: Sequence[int],
        chosen: Sequence[NDArray[np.int_]],
    ) -> tuple[Scenes, Sequence[ObjectPictures]]:
        """Returns the scenes of a batch, and the pictures of objects by their indices."""
        settings, pictures = self._settings, None
        # Furnished maps may have more objects than the maps before.
        map_room = Room.for_maps(maps, has_objects=self._has_objects)
        room = Room(*map(max, self._room, map_room))
        shown = None
        if settings.objects is not None:
            most = max(len(road_map.objects or ()) for road_map in maps)
            if most > _MOST_OBJECTS:
                expected = f"at most {_MOST_OBJECTS:,} in pictures of a map"
                raise InputError("objects", expected, f"{most:,}")
            pictures = _pack_objects(settings.objects)
            shown = [
                settings.objects.choose(road_map.objects or (), [settings.seed, index, 2])
                for road_map, index in zip(maps, indices, strict=True)
            ]
        # Maps add pictures of objects to those that are packed.
        with _packing:
            scenes = pack_scenes(
                maps,
                settings.tiles,
                settings.tile_px,
                pictures,
                room=room,
                chosen=chosen,
                shown=shown,
            )
        return scenes, () if pictures is None else pictures.pictures

    def _finish(
        self,
        road_map: RoadMap,
        index: int,
        chosen: NDArray[np.int_],
        plan: Plan,
        drawn: Pytree,
        pictures: Sequence[ObjectPictures],
    ) -> Sample:
        """Makes a sample of a drawn view."""
        settings = self._settings
        pixels = drawn.words[..., None].view(np.uint8)
        image = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGBA2RGB), np.uint8)
        labels = np.ascontiguousarray(pixels[..., 3])
        transform = _transform_of(plan, settings.tile_px, labels.shape)
        if self._is_wide or settings.transforms.compression:
            rng = np.random.default_rng([settings.seed, index, 4])
            if self._is_wide:
                image, transform = _blur_widely(rng, image, settings.transforms, transform)
            image = compress(rng, image, settings.transforms.compression)
        layers = {"image": image, "labels": labels}
        about = _about(plan) | {"lane_offset": settings.tiles.lane_offset}
        if settings.tiles.lane_offset_spread is not None:
            about["lane_offset_spread"] = settings.tiles.lane_offset_spread
        if settings.objects is not None:
            layers["instances"] = drawn.instances.astype(np.uint16)
            things = road_map.objects or ()
            about["objects"] = _list_objects(
                things, pictures, plan, drawn, transform, settings.tile_px
            )
        return Sample(layers, describe(settings, road_map, chosen, transform, labels, index, about))


# Threads draw side by side, and add pictures of objects to the same list.
_packing = Lock()


@lru_cache(maxsize=4)
def _pack_objects(objects: ObjectSet) -> PackedObjects:
    return PackedObjects(objects, whole=True)


def _vary(camera: LaneCamera, transforms: Transforms, *, is_wide: bool) -> Variation:
    """Returns what varies between views. A range of 0 leaves its step out."""
    poses = {name: getattr(camera, name) for name in PoseRanges.options()}
    looks: dict[str, OptionValue] = {
        name: value or None for name, value in transforms.values().items()
    }
    if is_wide:
        looks |= dict.fromkeys(("blur", "motion", "noise"))
    known = {name: value for name, value in looks.items() if name in Variation.options()}
    poses["lines"] = poses["lines"] or None
    return Variation(**poses, **known, horizon=1, haze=_HAZE)


def _blur_widely(
    rng: np.random.Generator,
    image: NDArray[np.uint8],
    transforms: Transforms,
    transform: DrawnTransform,
) -> tuple[NDArray[np.uint8], DrawnTransform]:
    """Smears and blurs a picture, and adds its noise, which comes after the blur."""
    image = vary_motion(rng, image, transforms.motion)
    blur, noise = rng.uniform(0, 1, 2) * (transforms.blur, transforms.noise)
    transform = transform._replace(blur=float(blur), noise=float(noise))
    # The gains and the offset are in the picture.
    plain = transform._replace(gains=(1, 1, 1), offset=0)
    return photograph(image, plain), transform


def _number(value: Numeric) -> float:
    """Returns a number of 32 bits as it is written in JSON."""
    return round(float(value), 7)


def _about(plan: Plan) -> dict[str, Plain]:
    """Returns the entries of the metadata about the pose and the camera."""
    options = ("height", "forward", "pitch", "field_of_view")
    camera: dict[str, Plain] = {name: _number(getattr(plan.camera, name)) for name in options}
    # Positions are in units of 2**-20 tile.
    camera["lines"] = 0.0 if plan.lines is None else _number(plan.lines / 2**20)
    if plan.camera.distortion is not None:
        camera["distortion"] = [*map(_number, plan.camera.distortion)]
    errors, nearest = (
        dict(zip(("d", "phi", "curvature"), map(_number, lane), strict=True))
        for lane in (plan.errors, plan.lane)
    )
    return {
        **errors,
        "pose": {name: _number(value) for name, value in plan.pose._asdict().items()},
        "nearest": nearest,
        "movement": {name: int(value) for name, value in plan.movement._asdict().items()},
        "camera": camera | {"sky": np.rint(plan.look.sky).astype(int).tolist()},
    }


def _transform_of(plan: Plan, tile_px: int, size: tuple[int, ...]) -> DrawnTransform:
    """Returns the transform from the plain map to a view, in front of a distorting lens."""
    x, y, theta = map(_number, plan.pose)
    # Points of the map in pixels become metres ahead of the camera and to the left.
    cosine, sine, metre = np.cos(theta), np.sin(theta), TILE / tile_px
    ahead = [cosine * metre, -sine * metre, TILE * (y * sine - x * cosine) - plan.camera.forward]
    left = [-sine * metre, -cosine * metre, TILE * (y * cosine + x * sine)]
    ground = np.array([ahead, left, [0, 0, 0], [0, 0, 1]])
    look = plan.look
    red, green, blue = map(_number, look.gains)
    return DrawnTransform(
        matrix=_camera_matrix(plan.camera) @ ground,
        size=(size[0], size[1]),
        gains=(red, green, blue),
        offset=_number(look.offset),
        blur=_number(look.blur),
        noise=0.0 if look.noise is None else _number(look.noise),
        noise_seed=int(look.seed),
    )


def _camera_matrix(camera: Camera) -> Float[NDArray, "3 4"]:
    """Returns the matrix from positions relative to a camera to points of its picture.

    The positions are in metres ahead of the camera, to the left, and above the ground.
    """
    focal = camera.rows / 2 / np.tan(np.radians(camera.field_of_view) / 2)
    cosine, sine = np.cos(np.radians(camera.pitch)), np.sin(np.radians(camera.pitch))
    # Right, down and depth in the camera's frame.
    down = [-sine, 0, -cosine, camera.height * cosine]
    depth = [cosine, 0, -sine, camera.height * sine]
    seen = np.array([[0, -1, 0, 0], down, depth])
    middle = np.array([[focal, 0, camera.columns / 2], [0, focal, camera.rows / 2], [0, 0, 1]])
    return np.asarray(middle @ seen)


def _list_objects(
    objects: Sequence[MapObject],
    pictures: Sequence[ObjectPictures],
    plan: Pytree,
    drawn: Pytree,
    transform: DrawnTransform,
    tile_px: int,
) -> list[SeenObject]:
    """Lists the objects that are seen, from the farthest to the nearest one."""
    camera, counts = plan.camera, np.bincount(drawn.instances.ravel())
    listed = []
    for number in np.flatnonzero(counts[1:]).tolist():
        thing, shown = objects[number], pictures[plan.pictures[number]]
        ahead, left = _from_camera(thing, plan)
        # Objects on the floor are behind all that stand.
        depth = np.inf
        placed = lay_flat(thing, shown, tile_px)
        onto_view = transform.matrix
        if shown.height:
            depth, onto_view = ahead, _camera_matrix(camera)
            placed = _stand(thing, shown, plan, ahead, left)
        placed = placed._replace(matrix=onto_view @ placed.matrix)
        rows, columns = np.nonzero(drawn.instances == number + 1)
        box = columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1
        whole, alone = measure_whole(
            placed, int(drawn.covered[number]), transform.size, NEAR, partial(_bend, camera)
        )
        record: SeenObject = {
            "kind": thing.kind,
            "instance": number + 1,
            "box": [int(part) for part in box],
            "whole": list(whole),
            "visible": len(rows) / alone,
            "distance": float(np.hypot(ahead, left)),
        }
        listed.append((-depth, number, record))
    return [record for _, _, record in sorted(listed, key=lambda item: item[:2])]


def _from_camera(thing: MapObject, plan: Plan) -> tuple[float, float]:
    """Returns the metres from the camera ahead and to the left to an object."""
    pose = plan.pose
    cosine, sine = np.cos(pose.theta), np.sin(pose.theta)
    # On the map y points south.
    east, north = (thing.x - pose.x) * TILE, (pose.y - thing.y) * TILE
    ahead = east * cosine + north * sine - plan.camera.forward
    return float(ahead), float(north * cosine - east * sine)


def _stand(
    thing: MapObject, shown: ObjectPictures, plan: Plan, ahead: float, left: float
) -> Placed:
    """Places the picture of an upright object, in metres ahead of the camera, to the left and up.

    It is parallel to the view's rows. Its view is chosen by the direction from which the camera
    sees the object.
    """
    towards = np.arctan2(-left, -ahead) + plan.pose.theta - thing.angle
    pixels = shown.view(towards)
    rows, columns = pixels.shape[:2]
    metre = thing.height / rows
    # From (column, row) of the picture.
    matrix = [
        [0, 0, ahead],
        [-metre, 0, left + columns / 2 * metre],
        [0, -metre, thing.height],
        [0, 0, 1],
    ]
    return Placed(pixels, np.array(matrix))


def _bend(camera: Camera, points: Float[NDArray, "N 2"]) -> Float[NDArray, "N 2"]:
    """Moves points of a picture as the camera's lens does."""
    if camera.distortion is None:
        return points
    middle = np.array([camera.columns, camera.rows]) / 2
    focal = camera.rows / 2 / np.tan(np.radians(camera.field_of_view) / 2)
    k1, k2 = camera.distortion
    square = (((points - middle) / focal) ** 2).sum(axis=1, keepdims=True)
    return middle + (points - middle) * (1 + k1 * square + k2 * square**2)

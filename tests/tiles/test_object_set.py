"""Object sets: the drawn one, the script that draws it, faults of one's own, and objects on maps as seen from above."""

import shutil

import cv2
import numpy as np
import pytest
from folders import read_picture
from refusals import refused

from elitelanes_jax.formats import OBJECT_KINDS, MapObject, RoadMap
from elitelanes_jax.tiles import load_objects, render
from elitelanes_jax.tiles.object_set import default_objects, draw_tag
from elitelanes_jax.tiles.pasting import Placed, paste
from experiments.perception.draw_objects import draw_all

TOWN = np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]], np.int8)
TILE, PX = 0.585, 64


def test_the_drawn_set_has_all_kinds_in_their_sizes():
    objects = load_objects()
    assert set(objects.kinds) == set(OBJECT_KINDS)
    for one in objects.pictures:
        usual = OBJECT_KINDS[one.kind]
        assert (one.height, *one.footprint) == usual[:3]
        for angle, picture in one.views.items():
            rows, columns = picture.shape[:2]
            opaque = picture[..., 3] >= 128
            assert opaque[-2:].any() and opaque[:4].any()  # it stands on the floor, and is as high as it should be
            turned = np.radians(angle)
            wide = abs(np.sin(turned)) * usual.length + abs(np.cos(turned)) * usual.width
            wide = usual.length if usual.is_round else wide
            assert columns / rows == pytest.approx(wide / usual.height, abs=2 / rows)


def test_a_picture_that_is_smaller_than_a_pixel_is_visible_in_whole():
    """At the edge, where its area is rounded to no pixel."""
    speck = Placed(np.full((1, 1, 4), 255, np.uint8), np.array([[0.6, 0, -0.05], [0, 0.6, 0.2], [0, 0, 1]]))
    owners, (seen,) = paste(np.zeros((2, 2, 3), np.uint8), [speck])
    assert owners.tolist() == [[1, 0], [0, 0]] and seen.visible == 1


@pytest.mark.skipif(int(cv2.__version__.split(".")[0]) < 5, reason="OpenCV 4 smooths edges in another way")
def test_the_script_draws_the_set(tmp_path):
    kinds = ["cone", "floor_tag", "sign_stop"]
    draw_all(tmp_path, kinds)
    folders = {folder.name for folder in default_objects().iterdir()}
    assert {folder.name for folder in tmp_path.iterdir()} == {
        name for name in folders if name.rpartition("_")[0] in kinds
    }
    for file in sorted(tmp_path.rglob("*.*")):
        kept = default_objects() / file.relative_to(tmp_path)
        if file.suffix == ".png":
            drawn, kept = read_picture(file), read_picture(kept)
            assert (np.abs(drawn.astype(int) - kept) > 2).mean() < 1e-3  # other machines round otherwise
        else:
            assert file.read_text() == kept.read_text()


@pytest.mark.parametrize(("kind", "tag"), [("sign_stop", 33), ("sign_T_intersect", 142), ("sign_street_name", 500)])
def test_a_sign_shows_its_own_tag(kind, tag):
    """OpenCV reads it in all views of its face."""
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    bare, shown = load_objects().choose([MapObject(kind, 1, 1, 0, 0.18, number) for number in (None, tag)])
    for angle, pixels in shown.views.items():
        assert (pixels[..., 3] == bare.views[angle][..., 3]).all()
        if angle in (0, 45, 315):
            opacity = pixels[..., 3:] / 255
            grey = cv2.copyMakeBorder(np.uint8(pixels[..., 0] * opacity[..., 0]), *[20] * 4, cv2.BORDER_CONSTANT)
            assert cv2.aruco.ArucoDetector(family).detectMarkers(cv2.resize(grey, None, fx=3, fy=3))[1] == [[tag]]
        else:
            assert pixels is bare.views[angle]


def slow_from_above(things, pictures, shape):
    """1 + the index of the object that each pixel shows: lower ones first, each pixel looked up by its place."""
    owners = np.zeros(shape, int)
    y, x = ((index + 0.5) / PX for index in np.mgrid[: shape[0], : shape[1]])
    for index in sorted(range(len(things)), key=lambda index: things[index].height):
        thing, one = things[index], pictures[index]
        east, north = (x - thing.x) * TILE, (thing.y - y) * TILE
        ahead = east * np.cos(thing.angle) + north * np.sin(thing.angle)
        left = north * np.cos(thing.angle) - east * np.sin(thing.angle)
        scale = thing.height / one.height if one.height else 1
        column = np.floor((ahead / (one.footprint[0] * scale) + 0.5) * one.top.shape[1])
        row = np.floor((0.5 - left / (one.footprint[1] * scale)) * one.top.shape[0])
        inside = (column >= 0) & (column < one.top.shape[1]) & (row >= 0) & (row < one.top.shape[0])
        picked = one.top[np.where(inside, row, 0).astype(int), np.where(inside, column, 0).astype(int), 3]
        owners[inside & (picked >= 128)] = index + 1
    return owners


def test_objects_lie_flat_from_above_and_hide_the_road(drawn_tiles):
    rng = np.random.default_rng(0)
    things = tuple(
        MapObject(kind, *rng.uniform(0, 3, 2), rng.uniform(-3, 3), size.height * rng.uniform(0.8, 1.2))
        for kind, size in OBJECT_KINDS.items()
    )
    seen = render(RoadMap(TOWN, objects=things), drawn_tiles, tile_px=PX, seed=3)
    bare = render(TOWN, drawn_tiles, tile_px=PX, seed=3)
    owners = slow_from_above(things, load_objects().choose(things, 3), seen.labels.shape)
    assert (owners == seen.instances).mean() > 0.9999 and len(np.unique(owners)) > 20
    hidden = seen.instances > 0
    for name in ("road", "red", "yellow", "labels"):
        np.testing.assert_array_equal(getattr(seen, name), np.where(hidden, 0, getattr(bare, name)))
    near = cv2.dilate(hidden.astype(np.uint8), np.ones((3, 3))) > 0
    assert (seen.image != bare.image).any(axis=-1)[~near].mean() < 0.01  # of poles thinner than a pixel
    assert (seen.image != bare.image).any(axis=-1)[hidden].mean() > 0.9
    assert bare.instances is None


@pytest.fixture
def own(tmp_path):
    """A set of one object with one view, as photographs make it."""
    place = tmp_path / "mine" / "duckie_1"
    shutil.copytree(default_objects() / "duckie_1", place)
    for file in (*place.glob("image_*"), place / "top.png"):
        file.unlink()
    return place


def test_unknown_kinds_are_drawn_as_boxes_or_with_ones_own_picture(own):
    boat = MapObject("other:boat", 1.5, 0.5, 0.0, 0.1)
    assert load_objects().choose([boat])[0].kind == "other"
    write(own, 'kind = "other:boat"\nheight = 0.1\nfootprint = [0.1, 0.1]')
    assert load_objects(own.parent).choose([boat])[0].kind == "other:boat"


def test_a_picture_alone_lies_on_the_floor_from_above(own, drawn_tiles):
    objects = load_objects(own.parent)
    (one,) = objects.pictures
    np.testing.assert_array_equal(one.view(2.5), one.views[0])
    thing = MapObject("duckie", 1.5, 1.5, 0.0, 0.3)
    seen = render(RoadMap(TOWN, objects=[thing]), drawn_tiles, tile_px=PX, objects=objects)
    columns, rows = (np.flatnonzero(seen.instances.any(axis=axis)) for axis in (0, 1))
    assert np.ptp(columns) + 1 == pytest.approx(0.3 / TILE * PX, abs=2)
    wide = np.ptp(np.flatnonzero((one.views[0][..., 3] >= 128).any(axis=0))) + 1
    assert np.ptp(rows) + 1 == pytest.approx(0.3 / TILE * PX * wide / one.views[0].shape[0], abs=2)


def write(place, text):
    (place / "object.toml").write_text(text)


def test_a_digest_is_of_all_that_a_picture_shows(own):
    digests = []
    for height, tag in ((0.1, 0.05), (0.2, 0.05), (0.1, 0.06)):
        write(own, f'kind = "duckie"\nheight = {height}\nfootprint = [0.1, 0.1]\ntag = [0.05, {tag}]')
        digests.append(load_objects(own.parent).digest)
    pixels = cv2.imread(str(own / "image.png"), cv2.IMREAD_UNCHANGED)
    pixels[len(pixels) // 2, pixels.shape[1] // 2, 0] ^= 1
    cv2.imwrite(str(own / "image.png"), pixels)
    assert len({*digests, load_objects(own.parent).digest}) == 4


def replace_by_a_folder(file):
    file.unlink(missing_ok=True)
    file.mkdir()


def written(text):
    return lambda place: write(place, text)


def copied(name):
    return lambda place: shutil.copy(place / "image.png", place / name)


DUCKIE = 'kind = "duckie"\nheight = 1\nfootprint = [1, 1]\n'
FAULTS = [
    (written('kind = "duck"\nheight = 1\nfootprint = [1, 1]'), "duckie_1/object.toml: kind", "'duck'", "one of"),
    (written('kind = "duckie"\nheight = 1'), "duckie_1/object.toml", "no footprint", "the keys"),
    (written('kind = "duckie"\nheight = 0\nfootprint = [1, 1]'), "duckie_1/object.toml: height", "0", "metres"),
    (written('kind = "duckie"\nheight = 1\nfootprint = [1]'), "duckie_1/object.toml: footprint", "[1]", "metres"),
    (written('kind = "floor_tag"\nheight = 0\nfootprint = [1, 1]'), "duckie_1", "none", "top.png"),
    (written(f"{DUCKIE}tag = 3"), "duckie_1/object.toml: tag", "3", "[middle, side]"),
    (written(f"{DUCKIE}tags = 3"), "duckie_1/object.toml", "'tags'", "tag"),
    *(
        (written(f"{DUCKIE}tag = [{tag}]"), "duckie_1/object.toml: tag", f"[{tag}]", "[middle, side]")
        for tag in ("nan, 0.1", "inf, 0.1", "-0.1, 0.1", "0.1, 0", "0.1, 11")
    ),
    (lambda place: (place / "image.png").unlink(), "duckie_1", "none", "image.png"),
    (lambda place: (place / "object.toml").unlink(), "duckie_1/object.toml", "no such file or directory", ""),
    (
        lambda place: cv2.imwrite(str(place / "image.png"), np.zeros((8, 8, 3), np.uint8)),
        "duckie_1/image.png",
        "one without",
        "transparency",
    ),
    *(
        (copied(name), "duckie_1", name, "views")
        for name in (
            *("image_400.png", "image_0.png", "image_045.png", "image_-45.png"),
            *("image_x.png", "image_.png", "image_22.5.png"),
        )
    ),
    (shutil.rmtree, "", "none", "object.toml and image.png"),
    (lambda place: replace_by_a_folder(place / "image.png"), "duckie_1", "none", "image.png"),
    (lambda place: replace_by_a_folder(place / "image_77.png"), "duckie_1/image_77.png", "none", "a PNG file"),
    (lambda place: (place / "image_77.png").symlink_to("lost"), "duckie_1/image_77.png", "none", "a PNG file"),
]


@pytest.mark.parametrize(("spoil", "place", "got", "expected"), FAULTS)
def test_faults_are_named(spoil, place, got, expected, own):
    spoil(own)
    with refused(own.parent / place, got, expected):
        load_objects(own.parent)


def test_a_folder_called_top_is_no_picture_from_above(own):
    replace_by_a_folder(own / "top.png")
    assert load_objects(own.parent).pictures[0].top.shape


def test_the_seed_of_a_choice_is_checked():
    with refused("seed", "-1"):
        load_objects().choose([], -1)


def test_a_tag_is_the_one_of_the_family():
    code = "".join(str(int(bit > 0)) for bit in draw_tag(0)[1:7, 1:7].flat)
    assert int(code, 2) == 0xD5D628584  # as in AprilTag's table of the family

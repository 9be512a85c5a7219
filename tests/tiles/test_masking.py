"""Masks by colour: as good as those that were drawn with the tiles, and never laid over those that are there."""

import cv2
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax.tiles.masking import COLOURS, Colour, mask_folder, parse_colour, propose_masks
from elitelanes_jax.tiles.tileset import MASKS, default_tiles


def overlaps(tiles, change):
    """Intersection over union of proposed and given masks, over all tiles of a set."""
    both, either = dict.fromkeys(MASKS, 0), dict.fromkeys(MASKS, 0)
    for tile in tiles.tiles:
        masks = propose_masks(change(tile.image))
        for name in MASKS:
            given = getattr(tile, name)
            both[name] += (given & masks[name]).sum()
            either[name] += (given | masks[name]).sum()
        assert not (masks["red"] & masks["yellow"]).any()
        assert not ((masks["red"] | masks["yellow"]) & ~masks["road"]).any()
    return {name: both[name] / either[name] for name in MASKS}


@pytest.mark.parametrize(
    ("tiles", "light", "least"),
    [
        ("drawn_tiles", 1, (0.995, 0.98, 0.95)),  # measured: 0.999, 0.985, 0.955
        ("real_tiles", 1, (0.995, 0.99, 0.97)),  # measured: 1.000, 0.998, 0.978
        ("drawn_tiles", 0.5, (0.99, 0.98, 0.92)),  # measured: 0.999, 0.986, 0.975
        ("drawn_tiles", 0.75, (0.99, 0.95, 0.9)),
        ("drawn_tiles", 1.25, (0.99, 0.95, 0.9)),
        ("drawn_tiles", (1.25, 1, 0.65), (0.99, 0.95, 0.9)),  # a lamp's
        ("real_tiles", (1.25, 1, 0.65), (0.99, 0.95, 0.9)),
        ("drawn_tiles", (0.85, 1, 1.2), (0.99, 0.95, 0.9)),  # a cloudy day's
        ("real_tiles", (0.65, 0.5, 0.36), (0.99, 0.95, 0.9)),
    ],
)
def test_proposals_are_close_to_the_masks_also_in_other_light(tiles, light, least, request):
    tiles = request.getfixturevalue(tiles)
    found = overlaps(tiles, lambda image: np.clip(image * np.array(light, float), 0, 255).astype(np.uint8))
    assert all(found[name] > limit for name, limit in zip(MASKS, least, strict=True)), found


def test_a_tile_of_another_size_gives_the_same_masks(drawn_tiles):
    tile = drawn_tiles.tiles[8]
    large = cv2.resize(tile.image, (1000, 1000), interpolation=cv2.INTER_CUBIC)
    for name, mask in propose_masks(large).items():
        given = cv2.resize(getattr(tile, name).astype(np.uint8), (1000, 1000), interpolation=cv2.INTER_NEAREST) > 0
        assert (mask & given).sum() >= 0.97 * (mask | given).sum(), name


def test_specks_are_no_tape():
    image = np.full((384, 384, 3), 60, np.uint8)
    image[100:115, 100:115] = image[200:260, 100:110] = 220, 30, 30
    red = propose_masks(image)["red"]
    assert not red[100:115].any() and red[205:255, 102:108].all()


def test_ranges_are_what_decides():
    """Patches of one colour each on a grey ground; hues that go on over the end."""
    image = np.full((96, 96, 3), 60, np.uint8)
    for row, hue in enumerate((0, 172, 60, 120)):
        patch = cv2.cvtColor(np.uint8([[[hue, 200, 200]]]), cv2.COLOR_HSV2RGB)
        image[8 + 20 * row : 24 + 20 * row, 30:60] = patch[0, 0]

    def patches(mask):
        return [bool(mask[16 + 20 * row, 45]) for row in range(4)]

    assert patches(propose_masks(image)["red"]) == [True, True, False, False]
    other = {**COLOURS, "red": Colour((100, 20), (150, 255), (90, 255)), "yellow": Colour((50, 70), (0, 255), (0, 255))}
    masks = propose_masks(image, other)
    assert patches(masks["red"]) == [True, True, False, True]
    assert patches(masks["yellow"]) == [False, False, True, False]
    assert masks["road"].all()
    masks = propose_masks(image, {**COLOURS, "yellow": COLOURS["red"]})
    assert patches(masks["red"]) == [True, True, False, False] and not masks["yellow"].any()
    narrow = {**COLOURS, "road": Colour((0, 179), (0, 255), (0, 59))}
    assert not propose_masks(image, narrow)["road"][:6].any()
    assert not any(mask.any() for mask in propose_masks(np.full((96, 96, 3), 255, np.uint8)).values())


def test_ranges_are_read_as_they_are_written():
    for colour in COLOURS.values():
        assert parse_colour(str(colour)) == colour
    assert parse_colour(" 165..10, 0..9,1..2 ") == ((165, 10), (0, 9), (1, 2))


def test_masks_that_are_there_stay(drawn_tiles, tmp_path):
    (tmp_path / "turn_1").mkdir()
    (tmp_path / "turn_2").mkdir()
    for place in tmp_path.iterdir():
        cv2.imwrite(str(place / "image.png"), drawn_tiles.tiles[0].image[..., ::-1])
    mine = np.zeros((384, 384), np.uint8)
    mine[:9] = 255
    cv2.imwrite(str(tmp_path / "turn_1" / "yellow.png"), mine)
    first, second = mask_folder(tmp_path)
    assert (first.folder.name, first.proposed) == ("turn_1", ("road", "red"))
    np.testing.assert_array_equal(first.masks["yellow"], mine > 0)
    assert (second.folder.name, second.proposed) == ("turn_2", ("road", "red", "yellow"))
    np.testing.assert_array_equal(first.masks["road"], second.masks["road"])
    again = mask_folder(tmp_path, overwrite=["yellow"])[0]
    assert again.proposed == ("road", "red", "yellow")  # the other two do not exist
    np.testing.assert_array_equal(again.masks["yellow"], second.masks["yellow"])
    assert sorted(path.name for path in tmp_path.rglob("*.png")) == ["image.png", "image.png", "yellow.png"]


def test_what_cannot_be_masked_is_named(tmp_path):
    with refused("", f"{tmp_path}: ... got none"):
        mask_folder(tmp_path)
    place = tmp_path / "turn_1"
    place.mkdir()
    with refused("", "...turn_1...got none"):
        mask_folder(tmp_path)
    cv2.imwrite(str(place / "image.png"), np.zeros((40, 40), np.uint8))
    with refused("", "...turn_1/image.png...got a grey one"):
        mask_folder(tmp_path)
    # The masks of a grey picture are made by hand.
    for name in MASKS:
        cv2.imwrite(str(place / f"{name}.png"), np.full((40, 40), 255, np.uint8))
    (by_hand,) = mask_folder(tmp_path)
    assert by_hand.proposed == () and all(mask.all() for mask in by_hand.masks.values())
    with refused("", "...turn_1/image.png...got a grey one"):
        mask_folder(tmp_path, overwrite=["red"])
    cv2.imwrite(str(place / "image.png"), np.zeros((1, 1, 3), np.uint8))
    with refused("", "...turn_1/image.png...got 1"):
        mask_folder(tmp_path)
    (tmp_path / "turn_2").mkdir()
    (place / "image.png").write_bytes(b"")
    with refused("", "...turn_1/image.png...got one that cannot be read...(and 1 more)"):
        mask_folder(tmp_path)


@pytest.mark.parametrize("size", [2, 3, 4])
def test_the_smallest_pictures_have_masks_of_their_own_pixels(size):
    """Without the outermost pixels nothing of two was left, and the mask was that of bytes beside the picture."""
    for grey, is_road in ((70, True), (250, False)):
        picture = np.full((size, size, 3), grey, np.uint8)
        picture[0, 0] += 4  # no picture in one colour
        for _ in range(20):
            assert (propose_masks(picture)["road"] == is_road).all()


@pytest.mark.parametrize("names", [["luck"], "red", ("road", "image")])
def test_masks_to_overwrite_are_named(names):
    """Unknown names were ignored."""
    with refused("overwrite", expected="one of"):
        mask_folder(default_tiles(), overwrite=names)


def test_a_sliver_of_the_floor_is_no_road():
    """White tape near the border, and a dark sliver outside of it that worn tape joins to the road."""
    image = np.full((200, 200, 3), 70, np.uint8)
    image[:, 3:17] = image[:, -17:-3] = 220
    image[120:126, 3:17] = 70
    road = propose_masks(image)["road"]
    assert road[:, 0].mean() < 0.1
    assert road[0, 40:160].all() and road[-1, 40:160].all()
    image[:, :17] = image[:, -17:] = 70
    image[:, :4] = image[:, -4:] = 220  # all that is left of the tape
    road = propose_masks(image)["road"]
    assert not road[:, 0].any() and not road[:, -1].any()

"""Pictures and masks with transparency, in every form that PNG has for it, written by Pillow."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image
from refusals import refused

from elitelanes_jax import RoadMap, load_tiles, render
from elitelanes_jax.cli.main import main
from elitelanes_jax.dataset import draw_sample
from elitelanes_jax.dataset._transforms import parse_transforms
from elitelanes_jax.tiles import choose_tiles, load_objects, mask_folder
from elitelanes_jax.tiles.files import GROUND, read_image
from elitelanes_jax.tiles.object_set import default_objects
from elitelanes_jax.tiles.rendering import show_paved
from elitelanes_jax.tiles.tileset import MASKS, default_tiles

TOWN = np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]], np.int8)
KINDS = ("turn_1", "straight_1", "crossing3_1", "crossing4_1")


@pytest.fixture
def folder(tmp_path):
    """A set of one tile of each kind, a quarter as large as the package's."""
    for file in (file for kind in KINDS for file in (default_tiles() / kind).glob("*.png")):
        copy = tmp_path / "tiles" / file.parent.name / file.name
        copy.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.asarray(Image.open(file))[::4, ::4]).save(copy)
    return tmp_path / "tiles"


@pytest.fixture
def plain(folder):
    return load_tiles(folder)


def rgba(mask, file):
    """White everywhere, and erased outside the mask."""
    Image.fromarray(np.dstack([np.full((*mask.shape, 3), 255, np.uint8), mask])).save(file)


def hidden_colours(mask, file):
    noise = np.random.default_rng(0).integers(0, 256, (*mask.shape, 3), np.uint8)
    noise[mask > 0] = 200
    Image.fromarray(np.dstack([noise, mask])).save(file)


def grey_with_opacity(mask, file):
    Image.fromarray(np.dstack([np.full_like(mask, 255), mask])).save(file)


def palette(mask, file):
    picture = Image.fromarray((mask > 0).astype(np.uint8), "P")
    picture.putpalette([255] * 6)
    picture.save(file, transparency=bytes([0, 255]))


def palette_of_two_bits(mask, file):
    picture = Image.fromarray((mask > 0).astype(np.uint8) * 3, "P")
    picture.putpalette([255] * 12)
    picture.save(file, transparency=bytes([0, 0, 0, 255]), bits=2)


def one_grey_is_transparent(mask, file):
    Image.fromarray(np.where(mask > 0, 255, 99).astype(np.uint8)).save(file, transparency=99)


def one_of_two_greys_is_transparent(mask, file):
    Image.fromarray(mask == 0).save(file, transparency=1)  # white is transparent, and the mask is black


def one_colour_is_transparent(mask, file):
    picture = np.where(mask[..., None] > 0, np.uint8(255), np.array([3, 200, 9], np.uint8))
    Image.fromarray(picture).save(file, transparency=(3, 200, 9))


FORMS = (
    rgba,
    hidden_colours,
    grey_with_opacity,
    palette,
    palette_of_two_bits,
    one_grey_is_transparent,
    one_colour_is_transparent,
)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", MASKS)
def test_a_transparent_pixel_is_no_mask(form, name, folder, plain):
    kind, index = ("crossing4_1", 3) if name == "red" else ("turn_1", 0)
    form(getattr(plain.tiles[index], name).astype(np.uint8) * 255, folder / kind / f"{name}.png")
    tile = load_tiles(folder).tiles[index]
    for mask in MASKS:
        np.testing.assert_array_equal(getattr(tile, mask), getattr(plain.tiles[index], mask))
    np.testing.assert_array_equal(tile.image, plain.tiles[index].image)
    share = 1 - getattr(tile, name).mean()
    assert tile.transparent == {name: pytest.approx(share)} and tile.opaque is None
    (existing, *_) = (one for one in mask_folder(folder) if one.folder.name == kind)
    np.testing.assert_array_equal(existing.masks[name], getattr(tile, name))


def test_a_mask_without_an_opaque_pixel_is_empty(folder):
    rgba(np.zeros((96, 96), np.uint8), folder / "straight_1/red.png")
    assert not load_tiles(folder).tiles[1].red.any()


def half_erased(mask, file):
    soft = cv2.GaussianBlur(mask, (9, 9), 2)
    Image.fromarray(np.dstack([np.full((*mask.shape, 3), 255, np.uint8), soft])).save(file)


def red_paint(mask, file):
    colours = np.where(mask[..., None] > 0, np.array([255, 0, 0], np.uint8), np.uint8(0))
    Image.fromarray(np.dstack([colours, mask])).save(file)


def black_paint(mask, file):
    Image.fromarray(np.dstack([np.zeros((*mask.shape, 3), np.uint8), mask])).save(file)


def sixteen_bits(mask, file):
    cv2.imwrite(str(file), np.dstack([np.full((*mask.shape, 3), 2**16 - 1), mask * 257.0]).astype(np.uint16))


def two_whites(mask, file):
    greys = np.where(mask > 0, 255, 0).astype(np.uint8)
    greys[:, ::2] //= 2
    Image.fromarray(np.dstack([greys, mask])).save(file)


REFUSED = [
    (half_erased, "an opacity of 1 of 255"),
    (red_paint, "one in colours"),
    (black_paint, "one in black on transparent ground"),
    (one_of_two_greys_is_transparent, "one in black on transparent ground"),
    (sixteen_bits, "uint16"),
    (two_whites, "3: 0, 127, 255"),
]


@pytest.mark.parametrize(("form", "got"), REFUSED)
@pytest.mark.parametrize("name", MASKS)
def test_a_mask_that_can_be_read_in_two_ways_is_refused(form, got, name, folder, plain):
    kind, index = ("crossing4_1", 3) if name == "red" else ("turn_1", 0)
    form(getattr(plain.tiles[index], name).astype(np.uint8) * 255, folder / kind / f"{name}.png")
    with refused("", f"{folder / kind / name}.png: ... got {got}"):
        load_tiles(folder)


@pytest.fixture
def cut(folder, plain):
    """The same set, with a turn whose picture has two transparent squares, one of them on its road."""
    clear = np.zeros((96, 96), bool)
    clear[:30, 66:] = clear[45:55, 45:55] = True
    picture = np.dstack([plain.tiles[0].image, np.where(clear, 0, 255)]).astype(np.uint8)
    picture[clear, :3] = 255, 0, 255
    Image.fromarray(picture).save(folder / "turn_1/image.png")
    return clear


def by_cell(chosen, layer):
    """Lays out a layer of the turn in all its cells, and 0 in the others."""
    cells = [[np.rot90(layer, turns) if tile == 0 else layer & False for tile, turns in row] for row in chosen]
    return np.block(cells)


@pytest.mark.parametrize("blend", [False, True])
def test_a_transparent_pixel_of_a_picture_is_ground(blend, folder, cut, plain):
    (folder / "tileset.toml").write_text(f"blend = {str(blend).lower()}\n")
    for kind in KINDS[1:]:  # other light, so that blending changes the turn
        bright = cv2.imread(str(folder / kind / "image.png")) // 2 + 90
        cv2.imwrite(str(folder / kind / "image.png"), bright)
    tiles = load_tiles(folder)
    tile = tiles.tiles[0]
    assert (tile.image[cut] == GROUND).all() and (tile.image[~cut] == plain.tiles[0].image[~cut]).all()
    for name in MASKS:
        np.testing.assert_array_equal(getattr(tile, name), getattr(plain.tiles[0], name) & ~cut)
    assert (plain.tiles[0].road & cut).any()
    assert (tile.opaque == ~cut).all() and tile.transparent == {"image": pytest.approx(cut.mean())}
    painted = replace(tiles, tiles=(tile._replace(opaque=None), *tiles.tiles[1:]))
    assert len({tiles.digest, plain.digest, painted.digest}) == 3

    chosen = choose_tiles(TOWN, tiles)
    picture = render(TOWN, tiles, tile_px=96, chosen=chosen)
    clear = by_cell(chosen, cut)
    assert (picture.image[clear] == GROUND).all() and not picture.labels[clear].any()
    shown = by_cell(chosen, plain.tiles[0].road) & ~clear
    assert picture.labels[shown].all()
    small = render(TOWN, tiles, tile_px=16, chosen=chosen)
    assert not (small.image == (255, 0, 255)).all(axis=-1).any()
    inside = cv2.erode(cv2.resize(clear.astype(np.uint8), (48, 48), interpolation=cv2.INTER_AREA), np.ones((3, 3)))
    assert (small.image[inside > 0] == GROUND).all() and inside.any()


def test_thin_lines_hide_the_ground_at_every_size(plain):
    """More than half of a pixel may be transparent beside a line that stays."""
    tapes = [tile._replace(road=tile.yellow, opaque=tile.yellow) for tile in plain.tiles]
    tiles = replace(plain, blend=True, tiles=tuple(tapes))
    chosen = choose_tiles(TOWN, tiles)
    picture = render(TOWN, tiles, tile_px=16, chosen=chosen)
    beside_ground = (picture.labels > 0) & ~show_paved(tiles, chosen, 16)
    assert beside_ground.any() and not (picture.image[beside_ground] == GROUND).all(axis=-1).any()


@pytest.mark.slow
def test_patterns_of_the_background_show_through(folder, cut):
    tiles = load_tiles(folder)
    transforms = parse_transforms(["none", "background=1"])
    sample = draw_sample(RoadMap(TOWN), tiles, 0, tile_px=96, transforms=transforms)
    clear = by_cell(choose_tiles(TOWN, tiles, [0, 0]), cut)
    assert (sample.layers["image"][clear] == GROUND).all(axis=-1).mean() < 0.01
    plain = draw_sample(RoadMap(TOWN), tiles, 0, tile_px=96)
    changed = (sample.layers["image"] != plain.layers["image"]).any(axis=-1)
    assert not changed[sample.layers["labels"] > 0].any()
    robot = draw_sample(RoadMap(TOWN), tiles, 0, tile_px=64, transforms=transforms, camera=[])
    assert not robot.layers["labels"][(robot.layers["image"] == GROUND).all(axis=-1)].any()


def test_a_half_transparent_pixel_is_mixed_with_the_ground(tmp_path):
    picture = np.array([[(200, 0, 100, 127), (200, 0, 100, 128)], [(9, 8, 7, 255), (9, 8, 7, 0)]], np.uint8)
    Image.fromarray(picture).save(tmp_path / "image.png")
    image = read_image(tmp_path / "image.png", [])
    assert image.opaque.tolist() == [[False, True], [True, False]] and image.transparent == 0.75
    assert image.pixels[1].tolist() == [[9, 8, 7], list(GROUND)]
    assert image.pixels[0].tolist() == [list(GROUND), [143, 59, 86]]


def test_proposals_leave_transparent_pixels_out(folder, cut):
    for mask in folder.glob("*/r*.png"):
        mask.unlink()
    cv2.imwrite(str(folder / "turn_1/yellow.png"), np.full((96, 96), 255, np.uint8))
    for proposal in mask_folder(folder):
        clear = cut if proposal.folder.name == "turn_1" else np.zeros_like(cut)
        assert not any(mask[clear].any() for mask in proposal.masks.values())
        assert proposal.masks["road"].any()
    grey = np.dstack([np.repeat(cv2.imread(str(folder / "turn_1/image.png"), 0)[..., None], 3, axis=2), ~cut * 255])
    cv2.imwrite(str(folder / "turn_1/image.png"), grey)
    with refused("", "...tiles/turn_1/image.png...got a grey one"):
        mask_folder(folder)


def test_check_names_transparency(folder, cut, plain, capsys):
    rgba(plain.tiles[1].yellow.astype(np.uint8) * 255, folder / "straight_1/yellow.png")
    shares = cut.mean(), 1 - plain.tiles[1].yellow.mean()
    main(["tiles", "check", str(folder)])
    told = capsys.readouterr()
    assert f"turn_1       opens SW    96 x 96 pixels, transparent: image {shares[0]:.1%}\n" in told.out, told.err
    assert f"96 x 96 pixels, transparent: yellow {shares[1]:.1%}\n" in told.out
    assert "transparent pixels of a mask are 0; those of a picture are ground, without road and lines" in told.out


def erase(part):
    def spoil(picture):
        picture[part] = 0

    return spoil


SPOILT = {
    "image.png: ... got one that is transparent everywhere": erase(np.s_[..., 3]),
    "road.png: ... got W, because image.png is transparent on a part of the road": erase(np.s_[75:, :, 3]),
}


@pytest.mark.parametrize("fault", SPOILT)
def test_a_picture_without_its_road_is_refused(fault, folder, plain):
    picture = np.dstack([plain.tiles[0].image, np.full((96, 96), 255, np.uint8)])
    SPOILT[fault](picture)
    Image.fromarray(picture).save(folder / "turn_1/image.png")
    with refused("", f"{folder}/turn_1/{fault}"):
        load_tiles(folder)


def test_an_opaque_channel_of_opacity_changes_nothing(folder, plain):
    for file in folder.glob("*/*.png"):
        Image.open(file).convert("RGBA").save(file)
    assert load_tiles(folder).digest == plain.digest
    assert not any(tile.transparent for tile in load_tiles(folder).tiles)


def test_objects_have_transparency_in_every_form(tmp_path):
    shutil.copytree(default_objects() / "cone_1", tmp_path / "set" / "cone_1")
    file = tmp_path / "set" / "cone_1" / "image.png"
    opaque = np.asarray(Image.open(file))[..., 3] >= 128
    for form in FORMS:
        form(opaque.astype(np.uint8) * 255, file)
        (cone,) = load_objects(file.parents[1]).pictures
        np.testing.assert_array_equal(cone.views[0][..., 3] > 0, opaque)

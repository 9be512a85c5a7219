"""The experiment on training: its judge, its network, its datasets, and that it runs."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from elitelanes_jax import RoadMap, rotate
from elitelanes_jax.dataset import draw_sample
from elitelanes_jax.network.wfc import generate_batch
from elitelanes_jax.tiles.tileset import default_tiles
from experiments.perception.photographs import main as photographed
from experiments.perception.training_sets import (
    Condition,
    draw_maps,
    patterns,
    shift_lines,
    split_tiles,
    training_set,
)

unet = pytest.importorskip("experiments.perception.unet", reason="flax and optax are not here", exc_type=ImportError)


def collapsed(count, seed, alphabet=range(3, 16)):
    alphabet = [code for code in alphabet if code.bit_count() > 1]
    return generate_batch(np.random.default_rng(seed), count, (8, 8), border="closed", alphabet=alphabet).grid


labels_of = hnp.arrays(np.uint8, (2, 3, 4), elements=st.integers(0, 3))


@given(labels_of, labels_of)
def test_intersections_over_unions_are_those_of_sets_of_pixels(wanted, found):
    counts = unet.confusion(wanted, found, 4)
    for label, iou in enumerate(unet.ious(counts)):
        one, other = (set(map(tuple, np.argwhere(labels == label).tolist())) for labels in (wanted, found))
        assert counts[label].tolist() == [
            len(one & set(map(tuple, np.argwhere(found == k).tolist()))) for k in range(4)
        ]
        if one | other:
            assert iou == len(one & other) / len(one | other)
        else:
            assert np.isnan(iou)


def test_packs_are_unpacked_as_they_were():
    x = np.arange(2 * 4 * 6 * 3).reshape(2, 4, 6, 3)
    packed = unet.space_to_depth(x)
    assert packed.shape == (2, 2, 3, 12)
    assert (unet.depth_to_space(packed) == x).all()


def test_crops_are_of_the_picture_and_its_labels_alike():
    labels = np.random.default_rng(0).integers(0, 256, (3, 9, 8), np.uint8)
    images = np.repeat(labels[..., None], 3, axis=-1)
    windows = {}
    for number, row, column, turns in np.ndindex(3, 6, 5, 4):
        window = np.rot90(labels[number, row : row + 4, column : column + 4], turns)
        windows[window.tobytes()] = number, row, column, turns
    keys = jax.random.split(jax.random.key(0), 6000)
    image, label = jax.vmap(lambda key: unet.random_crop(images, labels, 4, key))(keys)
    assert (np.asarray(image) == np.asarray(label)[..., None]).all()
    drawn_places = {windows[crop.tobytes()] for crop in np.asarray(label, np.uint8)}
    assert len(drawn_places) == len(windows)  # all of them come up


@pytest.mark.slow
def test_the_network_learns():
    seen, held_out = split_tiles(0)
    weights = unet.train(*draw_maps(collapsed(20, 0), [seen], seed=0), 4, 5, steps=150, batch=4, crop=64)
    test = draw_maps(collapsed(4, 1, held_out.alphabet), [held_out], seed=1)
    assert (test.labels == 1).mean() < 0.7
    assert unet.ious(unet.confusion(test.labels, unet.predict(weights, test.image, 4), 4))[1] > 0.9


def test_neighbourhoods_are_those_that_a_walk_over_the_maps_finds():
    grids = collapsed(3, 2)
    found = set()
    for grid in grids:
        for row, column in np.ndindex(7, 7):
            window = grid[row : row + 2, column : column + 2]
            found.add(frozenset(rotate(window, turns).tobytes() for turns in range(4)))
    assert len(patterns(grids)) == len(found)
    assert patterns(grids) == patterns([rotate(grid) for grid in grids])


def test_a_training_set_is_the_dataset_of_its_maps():
    grids = collapsed(2, 3)
    for transforms, one_picture in (("standard", False), ("none", True)):
        condition = Condition("", "wfc", 2, 5, transforms, one_picture)
        images, labels = training_set(condition, grids, seed=4)
        tiles, held_out = split_tiles(4)
        if one_picture:
            first = {tile.name[:-2]: tile for tile in reversed(tiles.tiles)}
            tiles = type(tiles)("", "", tuple(tile for tile in tiles.tiles if tile in first.values()))
            assert len(tiles.tiles) == len(first)
        assert not {tile.name for tile in tiles.tiles} & {tile.name for tile in held_out.tiles}
        for number in range(5):
            sample = draw_sample(RoadMap(grids[number % 2]), tiles, number, seed=4, tile_px=32, transforms=transforms)
            assert (images[number] == sample.layers["image"]).all()
            assert (labels[number] == sample.layers["labels"]).all()


def test_lines_shift_with_their_masks(drawn_tiles):
    for tile, same, wide, narrow in zip(
        *(shift_lines(drawn_tiles, shift).tiles for shift in (0, 0, 0.05, -0.05)), strict=True
    ):
        assert (same.image == tile.image).all() and (same.road == tile.road).all()
        for moved in (wide, narrow):
            for mask, least, most in ((moved.red, 0, 1), (moved.yellow, 1, 2)):  # of red and green, of green and blue
                if mask.any():
                    colour = moved.image[mask].mean(axis=0)
                    assert colour[least] > colour[most] + 60
        if tile.name.startswith("straight"):
            shares = [one.road.mean() for one in (narrow, tile, wide)]
            np.testing.assert_allclose(np.diff(shares), 0.1, atol=0.05)  # 0.05 tiles on each side, at the white line


@pytest.mark.slow
def test_lines_are_thinner_when_weights_are_taken_back():
    network = unet.UNet(4)
    weights = jax.jit(network.init)(jax.random.key(0), np.zeros((1, 16, 16, 3), np.uint8))
    images, apply = np.random.default_rng(0).integers(0, 256, (4, 16, 16, 3), np.uint8), jax.jit(network.apply)
    logits = [np.rot90(apply(weights, np.rot90(images, turns, (1, 2))), -turns, (1, 2)) for turns in range(4)]
    shares, chances = np.array([0.2, 0.7, 0.06, 0.04]), sum(np.asarray(jax.nn.softmax(one)) for one in logits)
    assert (unet.predict(weights, images, 4, batch=2) == logits[0].argmax(-1)).all()
    for unweighted in (0, 1.0):
        found = unet.predict(weights, images, 4, batch=2, shares=shares, unweighted=unweighted)
        assert (found == (chances * np.sqrt(shares) ** unweighted).argmax(-1)).mean() > 0.99
    assert np.bincount(found.ravel(), minlength=4)[1] > np.bincount(logits[0].argmax(-1).ravel(), minlength=4)[1]


@pytest.mark.slow
def test_photographs_are_measured_with_both_decisions(tmp_path):
    assert photographed(["--quick", "--photographs", str(default_tiles()), "--out", str(tmp_path / "out")]) == 0
    lines = (tmp_path / "out" / "photographs.md").read_text().splitlines()
    assert len(lines) == 2 + 2 * 2 and all(line.count("|") == 8 for line in lines)

"""Floors as stages of OpenUSD, by OpenUSD's own validators and readers (make mujoco)."""

import re
from math import cos, degrees, sin

import numpy as np
import pytest
from odd_names import ODD_NAMES, REFUSED
from refusals import refused
from test_floor import TOWN, city

from elitelanes_jax import RoadMap
from elitelanes_jax.formats import MapObject
from elitelanes_jax.formats.usd import to_usd
from elitelanes_jax.maps import furnish
from elitelanes_jax.maps.exporting import FORMATS
from elitelanes_jax.tiles.rendering import standing_objects

TILE = 0.6
# A round object at a corner of the map, one that is turned, and a kind with a colon.
OBJECTS = [
    MapObject("tree", 0.0, 0.0, 0.0, 0.25),
    MapObject("bus", 1.3, 2.1, 0.7, 0.12),
    MapObject("other:boat", 1.0, 0.5, 3.0, 0.1),
]


def test_bad_values_are_named():
    for arguments, subject, got, expected in (
        (((3, 3), "a@b.png"), "name", "'a@b.png'", "without"),
        (((3, 3), "town.png", 0), "tile_size", "0", ""),
    ):
        with refused(subject, got, expected):
            to_usd(*arguments)


def test_objects_have_the_places_angles_and_sides_of_the_map():
    _, *solids = to_usd(TOWN.shape, "town.png", TILE, standing_objects(OBJECTS)).split("def Cube")
    for solid, thing in zip(solids, OBJECTS, strict=True):
        found = dict(re.findall(r"xformOp:(\w+) = \(?([^)\n]*)", solid))
        place, (turned,), half = ([float(part) for part in found[name].split(",")] for name in found)
        length, width, height = (side * TILE / 0.585 / 2 for side in (*thing.footprint, thing.height))
        assert place == pytest.approx([thing.x * TILE, (len(TOWN) - thing.y) * TILE, height], rel=1e-5)
        assert turned == pytest.approx(degrees(thing.angle), rel=1e-5)
        assert half == pytest.approx([length, width, height], rel=1e-5)


@pytest.fixture
def pxr():
    return pytest.importorskip("pxr", reason="usd-core is not here: make mujoco")


def write(folder, road_map, name="town"):
    stage = folder / f"{name}.usda"
    for file, content in FORMATS["usd"].files(road_map, name, tile_px=16, tile_size=TILE).items():
        (folder / file).write_bytes(content)
    return stage


def validate(file):
    """Returns the names of the errors that all of OpenUSD's validators find."""
    from pxr import Usd, UsdValidation

    registry = UsdValidation.ValidationRegistry()
    validators = registry.GetOrLoadAllValidators()
    assert len(validators) >= 30
    found = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(file)))
    return [error.GetName() for error in found]


@pytest.mark.slow
def test_the_validators_find_nothing(pxr, tmp_path):
    for number in range(100):
        town = RoadMap(city(number))
        if number % 2:
            town = furnish(town, "signs=possible lights=0.3")
        # OpenUSD keeps what it has read of a file, so each stage has a file of its own.
        assert validate(write(tmp_path, town, f"town-{number}")) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ('"MaterialBindingAPI", ', "", "MissingMaterialBindingAPI"),
        ('upAxis = "Z"', "", "MissingUpAxisMetadata"),
        ("@./town.png@", "@./village.png@", "UnresolvableDependency"),
    ],
)
def test_the_validators_find_faults(pxr, old, new, error, tmp_path):
    file = write(tmp_path, RoadMap(TOWN))
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    assert error in validate(file)


@pytest.mark.slow
def test_floor_and_objects_are_where_they_should_be(pxr, tmp_path):
    from pxr import Gf, Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.Open(str(write(tmp_path, RoadMap(TOWN, objects=OBJECTS))))
    solids = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    assert [prim.GetTypeName() for prim in solids] == ["Mesh"] + ["Cube"] * len(OBJECTS)
    rows, columns = TOWN.shape
    mesh = UsdGeom.Mesh(solids[0])
    corners = np.array([(0, 0, 0), (columns, 0, 0), (columns, rows, 0), (0, rows, 0)]) * TILE
    np.testing.assert_allclose(mesh.GetPointsAttr().Get(), corners, rtol=1e-5)
    # The picture's lower left corner, which USD has at (0, 0), is the map's south-west.
    np.testing.assert_allclose(
        UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get(), corners[:, :2] / corners.max(axis=0)[:2]
    )
    for prim, thing in zip(solids[1:], OBJECTS, strict=True):
        place = UsdGeom.XformCache().GetLocalToWorldTransform(prim)
        length, width = (side * TILE / 0.585 for side in thing.footprint)
        height = thing.height * TILE / 0.585
        expected = np.array([thing.x * TILE, (rows - thing.y) * TILE, height / 2])
        np.testing.assert_allclose(place.Transform(Gf.Vec3d(0, 0, 0)), expected, atol=1e-5)
        ahead = np.array([cos(thing.angle), sin(thing.angle), 0]) * length / 2
        left = np.array([-sin(thing.angle), cos(thing.angle), 0]) * width / 2
        corner = expected + ahead + left + [0, 0, height / 2]
        np.testing.assert_allclose(place.Transform(Gf.Vec3d(1, 1, 1)), corner, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted({*ODD_NAMES} - REFUSED["usd"]))
def test_pictures_of_odd_names_are_found(pxr, kind, tmp_path):
    assert validate(write(tmp_path, RoadMap(TOWN), ODD_NAMES[kind])) == []

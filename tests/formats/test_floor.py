"""The floor of 3-D simulators: what its files say, and what MuJoCo and trimesh make of them."""

import io
import json
import shutil
import struct
import xml.etree.ElementTree as ET
from itertools import pairwise

import cv2
import jax
import networkx as nx
import numpy as np
import pytest
from drive.driving_oracle import lane_graph as movement_graph
from odd_names import ODD_NAMES, REFUSED
from refusals import refused
from scipy.ndimage import distance_transform_edt

from elitelanes_jax import RoadMap
from elitelanes_jax.drive import Camera, Pose, lane_pose, look, make_sight
from elitelanes_jax.drive.lanes import lane_length, lane_point
from elitelanes_jax.drive.robot import TILE, Robot
from elitelanes_jax.formats import MapObject
from elitelanes_jax.formats.gltf import to_gltf
from elitelanes_jax.formats.mujoco import WHEEL_DISTANCE, WHEEL_RADIUS, to_mjcf
from elitelanes_jax.lanes.movements import Movement, lane_graph
from elitelanes_jax.maps import furnish
from elitelanes_jax.maps.exporting import FORMATS
from elitelanes_jax.network import wfc
from elitelanes_jax.tiles import choose_tiles, load_tiles, render
from elitelanes_jax.tiles.rendering import png_of, standing_objects
from elitelanes_jax.tiles.tileset import default_tiles

TOWN = wfc.generate_batch(np.random.default_rng(0), 1, (6, 8), border="closed").grid[0]
SPEED, LOOKAHEAD, RATE = 0.3, 0.12, 1 / 30  # metres a second, tiles, seconds between commands
locate = jax.jit(jax.vmap(lane_pose, in_axes=(None, 0, 0)))


def test_the_robot_has_the_measures_of_ours():
    model = ET.fromstring(to_mjcf(TOWN, "town.png"))
    robot, camera = Robot(), Camera()
    found = model.find(".//camera")
    forward, left, above = map(float, found.get("pos").split())
    up = [float(part) for part in found.get("xyaxes").split()[3:]]
    assert (forward, left, above + WHEEL_RADIUS) == pytest.approx((camera.forward, 0, camera.height))
    assert np.degrees(np.arctan2(up[0], up[2])) == pytest.approx(camera.pitch)
    assert float(found.get("fovy")) == camera.field_of_view
    assert robot.wheel_distance == WHEEL_DISTANCE
    for motor in model.iter("velocity"):
        assert [float(part) * WHEEL_RADIUS for part in motor.get("ctrlrange").split()] == pytest.approx(
            [-robot.top_speed, robot.top_speed], rel=1e-5
        )
    ground = model.find(".//geom[@name='ground']").get("rgba").split()[:3]
    assert [255 * float(part) for part in ground] == pytest.approx(camera.ground, abs=0.2)


@pytest.mark.parametrize("number", range(12))
def test_the_robot_starts_in_the_middle_of_a_lane(number):
    grid = wfc.generate_batch(np.random.default_rng(number), 1, (3, 4), border="open").grid[0]
    body = ET.fromstring(to_mjcf(grid, "town.png")).find(".//body[@name='robot']")
    x, y, _ = (float(part) / TILE for part in body.get("pos").split())
    theta = np.radians(float(body.get("euler").split()[2]))
    found = lane_pose(grid, Pose(*np.float32([x, len(grid) - y, theta])))
    assert found.own_lane and abs(found.d) < 1e-4 and abs(found.phi) < 1e-4


def test_the_robot_starts_on_the_lanes_of_the_tile_set(tmp_path):
    shutil.copytree(default_tiles(), tmp_path / "tiles")
    with (tmp_path / "tiles" / "tileset.toml").open("a") as file:
        file.write("lane_offset = 0.25\n")
    model, _ = FORMATS["mujoco"].files(RoadMap(TOWN), "town", tile_px=16, tiles=load_tiles(tmp_path / "tiles")).values()
    body = ET.fromstring(model).find(".//body[@name='robot']")
    x, y, _ = (float(part) / TILE for part in body.get("pos").split())
    theta = np.radians(float(body.get("euler").split()[2]))
    found = lane_pose(TOWN, Pose(*np.float32([x, len(TOWN) - y, theta])), lane_offset=0.25)
    assert found.found and abs(found.d) < 1e-4 and abs(found.phi) < 1e-4
    with refused("lane_offset", "0.5"):
        to_mjcf(TOWN, "town.png", lane_offset=0.5)


def test_a_floor_lies_from_corner_to_corner_with_its_picture():
    """The file read by the rules of the format."""
    picture = png_of(render(TOWN, tile_px=16).image)
    text = to_gltf(TOWN.shape, picture, 0.5)
    magic, version, length = struct.unpack("<4sII", text[:12])
    assert (magic, version, length) == (b"glTF", 2, len(text))
    size, kind = struct.unpack("<I4s", text[12:20])
    content, rest = json.loads(text[20 : 20 + size]), text[20 + size :]
    assert kind == b"JSON" and struct.unpack("<I4s", rest[:8]) == (len(rest) - 8, b"BIN\0")
    parts = [
        rest[8 + view["byteOffset"] : 8 + view["byteOffset"] + view["byteLength"]] for view in content["bufferViews"]
    ]
    assert all(view["byteOffset"] % 4 == 0 for view in content["bufferViews"])
    assert parts[content["images"][0]["bufferView"]] == picture
    attributes = content["meshes"][0]["primitives"][0]["attributes"]
    corners = np.frombuffer(parts[attributes["POSITION"]], "<f4").reshape(4, 3)
    spots = np.frombuffer(parts[attributes["TEXCOORD_0"]], "<f4").reshape(4, 2)
    (node,) = content["nodes"]
    places = np.c_[corners, np.ones(4)] @ np.reshape(node["matrix"], (4, 4))
    np.testing.assert_array_equal(places, np.c_[spots[:, 0] * 4, 0 * spots[:, 0], (spots[:, 1] - 1) * 3, np.ones(4)])
    accessor = content["accessors"][attributes["POSITION"]]
    assert (accessor["min"], accessor["max"]) == ([-0.5, 0, 0], [0.5, 1, 0])


THINGS = [
    MapObject("sign_stop", 1.5, 2.25, np.pi, 0.18),  # who drives east reads it
    MapObject("house", 3.2, 0.6, 0.3, 0.4),
    MapObject("duckie", 0.5, 0.5, -1.0, 0.08),
    MapObject("floor_tag", 1.0, 1.0, 0.0, 0.0),
    MapObject("sign_stop", 4.0, 4.0, 0.0, 0.18),
]


def test_objects_stand_on_the_floor_and_face_their_readers():
    """Pictures are as high as their objects, above their places, and read from the side that objects face."""
    standing = standing_objects(THINGS)
    assert [one.thing for one in standing] == [thing for thing in THINGS if thing.height]
    text = to_gltf(TOWN.shape, png_of(render(TOWN, tile_px=16).image), 2 * TILE, standing)
    content = json.loads(text[20 : 20 + struct.unpack("<I", text[12:16])[0]])
    floor, *nodes = content["nodes"]
    assert floor["name"] == "floor" and len(content["meshes"]) == len(content["images"]) == 4  # two signs share theirs
    for (thing, front, wide, colour), node in zip(standing, nodes, strict=True):
        right, up, ahead, place = np.reshape(node["matrix"], (4, 4))[:, :3]
        assert node["name"] == thing.kind
        assert place / (2 * TILE) == pytest.approx([thing.x, 0, thing.y - len(TOWN)])
        assert up == pytest.approx([0, 2 * thing.height, 0]) and np.linalg.norm(right) == pytest.approx(2 * wide)
        assert ahead == pytest.approx([np.cos(thing.angle), 0, -np.sin(thing.angle)])
        assert np.cross(right, up) == pytest.approx(ahead * 4 * wide * thing.height)  # not mirrored
        pixels = cv2.imdecode(np.frombuffer(front, np.uint8), cv2.IMREAD_UNCHANGED)
        assert wide / thing.height == pytest.approx(pixels.shape[1] / pixels.shape[0])
        assert colour == pytest.approx(pixels[pixels[..., 3] > 127][:, 2::-1].mean(axis=0) / 255)
    red, green, blue = standing[0].colour
    assert red > 1.3 * max(green, blue)  # of a stop sign
    model = ET.fromstring(to_mjcf(TOWN, "town.png", 2 * TILE, standing))
    solids = [one for one in model.iter("geom") if one.get("type") in ("box", "cylinder")][: len(standing)]
    for (thing, *_), solid in zip(standing, solids, strict=True):
        place = [float(part) for part in solid.get("pos").split()]
        expected = thing.x * 2 * TILE, (len(TOWN) - thing.y) * 2 * TILE, thing.height
        assert place == pytest.approx(expected, rel=1e-5)
        assert float(solid.get("euler").split()[2]) == pytest.approx(np.degrees(thing.angle), rel=1e-5)
        half = [float(part) for part in solid.get("size").split()]
        assert (
            half[-1] == place[2] and half[0] == pytest.approx(thing.footprint[0]) and (len(half) == 2) == thing.is_round
        )


def city(number, largest=24):
    """Maps of 6 x 6 to 24 x 24 tiles in three styles: few crossings or many, and roads that leave the map."""
    rng = np.random.default_rng(number)
    height, width = map(int, rng.integers(6, largest + 1, 2))
    style = [{"border": "closed"}, {"border": "closed", "crossing_ban": False}, {"border": "open"}][number % 3]
    return wfc.generate_batch(rng, 1, (height, width), **style).grid[0]


def test_mjx_has_each_pair_of_shapes_that_may_touch():
    """MJX knows no contact of a box with a cylinder: wheels and chassis meet the floor alone, capsules meet objects."""
    text = FORMATS["mujoco"].files(RoadMap(TOWN, objects=THINGS), "city")["city.xml"].decode()
    robot = ET.fromstring(text).find("worldbody/body")
    parts = [geom.attrib for geom in robot.iter("geom")]
    floor, *still = [geom.attrib for geom in ET.fromstring(text).findall("worldbody/geom")[1:]]
    assert floor["name"] == "floor" and {one["type"] for one in still} == {"box", "cylinder"}

    def touch(one, other):
        return any(int(a.get("contype", 1)) & int(b.get("conaffinity", 1)) for a, b in ((one, other), (other, one)))

    assert {one["type"] for one in parts if touch(one, floor)} == {"box", "sphere", "cylinder"}
    assert [one["type"] for one in parts if touch(one, still[0])] == ["capsule"] * 2
    assert all(touch(one, {}) for one in (*parts, floor, *still))  # what users add touches everything


@pytest.mark.slow
def test_trimesh_reads_the_floor_as_it_was_written():
    trimesh = pytest.importorskip("trimesh")
    for number in range(1000):
        codes = city(number)
        (made,) = FORMATS["gltf"].files(RoadMap(codes), "city", tile_px=16).values()
        scene = trimesh.load(io.BytesIO(made), file_type="glb")
        (floor,) = scene.geometry.values()
        height, width = codes.shape
        floor.apply_transform(scene.graph.get(scene.graph.nodes_geometry[0])[0])
        np.testing.assert_allclose(floor.bounds, [[0, 0, -height * TILE], [width * TILE, 0, 0]], atol=1e-5)
        np.testing.assert_allclose(floor.face_normals, [[0, 1, 0]] * 2)
        east, north = floor.visual.uv.T  # trimesh counts from the south
        np.testing.assert_allclose(floor.vertices[:, 0], east * width * TILE, atol=1e-5)
        np.testing.assert_allclose(-floor.vertices[:, 2], north * height * TILE, atol=1e-5)
        np.testing.assert_array_equal(
            np.asarray(floor.visual.material.baseColorTexture), render(codes, tile_px=16, seed=0).image
        )


@pytest.mark.slow
def test_trimesh_sees_objects_where_they_stand():
    trimesh = pytest.importorskip("trimesh")
    (made,) = FORMATS["gltf"].files(RoadMap(TOWN, objects=THINGS), "city").values()
    meshes = trimesh.load(io.BytesIO(made), file_type="glb").dump()
    for thing, front, wide, _ in standing_objects(THINGS):
        middle = [thing.x * TILE, thing.height / 2, (thing.y - len(TOWN)) * TILE]
        (one,) = (mesh for mesh in meshes if np.allclose(mesh.bounds.mean(axis=0), middle, atol=1e-6))
        np.testing.assert_allclose(one.face_normals, [[np.cos(thing.angle), 0, -np.sin(thing.angle)]] * 2, atol=1e-6)
        assert one.area == pytest.approx(wide * thing.height)
        pixels = cv2.imdecode(np.frombuffer(front, np.uint8), cv2.IMREAD_UNCHANGED)[..., [2, 1, 0, 3]]
        np.testing.assert_array_equal(one.visual.material.baseColorTexture, pixels)


@pytest.fixture
def mujoco(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    return pytest.importorskip("mujoco")


def load(mujoco, road_map, tile_px=64):
    text, picture = FORMATS["mujoco"].files(road_map, "city", tile_px=tile_px).values()
    model = mujoco.MjModel.from_xml_string(text.decode(), assets={"city.png": picture})
    return model, mujoco.MjData(model)


def where(data, height):
    """The robot's pose in tiles, as ours have it."""
    x, y, _ = data.body("robot").xpos / TILE
    turned = data.body("robot").xmat.reshape(3, 3)
    return np.array([x, height - y, np.arctan2(turned[1, 0], turned[0, 0])], np.float32)


def put(mujoco, data, pose, height):
    """Puts the robot at a pose of ours."""
    mujoco.mj_resetData(data.model, data)
    data.qpos[:3] = pose.x * TILE, (height - pose.y) * TILE, WHEEL_RADIUS
    data.qpos[3:7] = np.cos(pose.theta / 2), 0, 0, np.sin(pose.theta / 2)
    mujoco.mj_forward(data.model, data)


def ways(codes, count, rng):
    """Random routes of 4 tiles or more: their movements, and points on each, a hundredth of a tile apart."""
    graph, nodes = movement_graph(codes), np.stack(lane_graph(codes).nodes, axis=1).tolist()
    while count:
        start, goal = (tuple(nodes[number]) for number in rng.integers(0, len(nodes), 2))
        path = nx.shortest_path(graph, start, goal) if nx.has_path(graph, start, goal) else []
        if len(path) > 4:
            taken = [Movement(*node, graph.edges[node, onward]["turn"]) for node, onward in pairwise(path)]
            points = [
                np.stack(lane_point(jax.tree.map(np.int32, one), np.arange(0, float(lane_length(one.turn)), 0.01))[:2])
                for one in taken
            ]
            yield taken, points
            count -= 1


def drive(mujoco, model, data, points, height, taken):
    """Drives along points by pure pursuit until the last few; returns the poses, and the movement at each."""
    put(mujoco, data, lane_point(jax.tree.map(np.int32, taken[0]), 0.02), height)
    line, owner = np.concatenate(points, axis=1), np.repeat(np.arange(len(points)), [one.shape[1] for one in points])
    at, ahead, poses, owners = 0, round(LOOKAHEAD / 0.01), [], []
    for _ in range(round(len(owner) * 0.01 * TILE / SPEED / RATE * 2)):
        x, y, theta = where(data, height)
        window = line[:, at : at + 50]
        at += int(np.argmin(np.hypot(window[0] - x, window[1] - y)))
        poses.append((x, y, theta))
        owners.append(owner[at])
        if at + ahead >= len(owner):
            return np.array(poses, np.float32), owners
        east, north = line[0, at + ahead] - x, y - line[1, at + ahead]
        left = north * np.cos(theta) - east * np.sin(theta)
        turn = SPEED * 2 * left / (east**2 + north**2) / TILE
        data.ctrl[:] = (SPEED + np.array([-1, 1]) * turn * WHEEL_DISTANCE / 2) / WHEEL_RADIUS
        mujoco.mj_step(model, data, round(RATE / model.opt.timestep))
    raise AssertionError("the goal was not reached")


@pytest.mark.slow
def test_mujoco_loads_maps_and_the_robot_stands_on_its_wheels(mujoco):
    for number in range(1000):
        model, data = load(mujoco, RoadMap(city(number)), 16)
        mujoco.mj_forward(model, data)
        before = data.body("robot").xpos.copy()
        mujoco.mj_step(model, data, 100)
        np.testing.assert_allclose(data.body("robot").xpos, before, atol=1e-3)
        assert data.body("robot").xmat[8] > 0.999  # upright
        assert before[2] == WHEEL_RADIUS and not data.warning.number.any()


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted({*ODD_NAMES} - REFUSED["mujoco"]))
def test_mujoco_finds_pictures_of_odd_names(mujoco, kind, tmp_path):
    model = tmp_path / f"{ODD_NAMES[kind]}.xml"
    for file, content in FORMATS["mujoco"].files(RoadMap(TOWN), ODD_NAMES[kind], tile_px=16).items():
        (tmp_path / file).write_bytes(content)
    assert mujoco.MjModel.from_xml_path(str(model)).ntex == 2


@pytest.mark.slow
def test_pure_pursuit_drives_through_mujoco_within_its_lane(mujoco, any_types):
    """100 routes on 20 maps: the robot's middle is never further from the middle of its lane than half of the lane."""
    worst, driven = 0.0, 0
    for number in range(20):
        rng, codes = np.random.default_rng(number), city(number)
        model, data = load(mujoco, RoadMap(codes), 16)
        for taken, points in ways(codes, 5, rng):
            poses, owners = drive(mujoco, model, data, points, len(codes), taken)
            on = Movement(*np.array([taken[owner] for owner in owners], np.int32).T)
            found = locate(codes, Pose(*poses.T), on)
            worst, driven = max(worst, float(np.abs(found.d).max())), driven + 1
            assert np.asarray(found.found).all() and np.asarray(found.own_lane).all()
    print(f"{driven} routes, at most {worst:.3f} tile from the lane's middle")
    assert driven == 100


@pytest.mark.slow
def test_the_camera_of_mujoco_sees_lines_where_ours_does(mujoco, any_types):
    """Every piece of a line that one camera sees clearly is within 2 pixels of such a line in the other's picture.

    Both see the same picture of the map. MuJoCo blurs thin lines that are far away, so lines are compared up to a tile
    ahead.
    """
    tiles, camera = load_tiles(), Camera(rows=480, columns=640)
    sight = make_sight(tiles, camera, tile_px=256)
    furthest = 0.0
    for number in range(10):
        rng, codes = np.random.default_rng(number), city(number, 10)
        model, data = load(mujoco, RoadMap(codes), 256)
        chosen = choose_tiles(codes, tiles, 0)
        with mujoco.Renderer(model, 480, 640) as renderer:
            for _, points in ways(codes, 4, rng):
                line = np.concatenate(points, axis=1)
                at = rng.integers(0, line.shape[1] - 2)
                step = line[:, at + 1] - line[:, at]
                put(mujoco, data, Pose(*line[:, at], np.arctan2(-step[1], step[0])), len(codes))
                renderer.update_scene(data, "camera")
                pose = Pose(*where(data, len(codes)))
                ours = look(pose, codes, sight, chosen=chosen)
                one, other = renderer.render().astype(int), np.asarray(ours.image).astype(int)
                for colour, faint in ((is_white, 0.6), (is_yellow, 0.4), (is_red, 0.4)):
                    furthest = max(furthest, apart(colour(one, 1), colour(other, faint)))
                    furthest = max(furthest, apart(colour(other, 1), colour(one, faint)))
    print(f"lines are at most {furthest:.1f} pixels apart")
    assert furthest <= 2


NEAR = 200  # the first row of pixels that is compared, a tile ahead


def is_white(picture, clear):
    return picture.min(axis=-1) > 180 * clear


def is_yellow(picture, clear):
    red, green, blue = picture.transpose(2, 0, 1)
    return (np.minimum(red, green) - blue > 100 * clear) & (abs(red - green) < 60)


def is_red(picture, clear):
    red, green, blue = picture.transpose(2, 0, 1)
    return red - np.maximum(green, blue) > 120 * clear


def apart(one, other):
    """The distance in pixels of the furthest pixel of one, below the horizon and within a picture's edge, to other."""
    return float(distance_transform_edt(~other)[NEAR:, 2:-2][one[NEAR:, 2:-2]].max(initial=0))


@pytest.mark.slow
def test_objects_stand_in_mujoco_and_stop_the_robot(mujoco):
    model, data = load(mujoco, RoadMap(TOWN, objects=THINGS))
    mujoco.mj_forward(model, data)
    for number, (thing, *_) in enumerate(standing_objects(THINGS)):
        above, hit = np.array([thing.x * TILE, (len(TOWN) - thing.y) * TILE, 5]), np.array([-1], np.int32)
        fall = mujoco.mj_ray(model, data, above, np.array([0.0, 0, -1]), None, 1, -1, hit, None)
        assert (model.geom(hit[0]).name, fall) == (f"{thing.kind} {number}", pytest.approx(5 - thing.height))
    house = THINGS[1]
    put(mujoco, data, Pose(house.x - 1.3, house.y, 0.0), len(TOWN))
    data.ctrl[:] = SPEED / WHEEL_RADIUS
    mujoco.mj_step(model, data, 2500)  # 1.5 m on a free floor
    x, y, _ = where(data, len(TOWN))
    assert house.x - 1.2 < x < house.x - 0.5 and abs(y - house.y) < 1


@pytest.mark.slow
def test_mjx_loads_furnished_maps_and_drives_as_mujoco_does(mujoco):
    mjx = pytest.importorskip("mujoco.mjx")
    jax = pytest.importorskip("jax")
    model, data = load(mujoco, furnish(TOWN, "all"))
    model_there, data_there = mjx.put_model(model), mjx.put_data(model, data)
    data.ctrl[:] = 9.4, 9.0
    data_there = data_there.replace(ctrl=jax.numpy.array([9.4, 9.0]))
    step = jax.jit(mjx.step)
    for _ in range(200):
        mujoco.mj_step(model, data)
        data_there = step(model_there, data_there)
    assert np.abs(np.array(data_there.qpos)[:7] - data.qpos[:7]).max() < 0.01  # the place of the robot

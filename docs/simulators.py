"""Draws the pictures of docs/simulators.md that the simulators in the environment can draw.

MUJOCO_GL=egl python docs/simulators.py, in .venv-mujoco, in .venv-simulators where make simulators has run, and in
.venv where make metadrive and make pufferdrive have run
"""

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import RoadMap, export, read_map
from elitelanes_jax.drive import Camera, Pose, look, make_sight
from elitelanes_jax.maps import FormatOptions, furnish
from elitelanes_jax.tiles import choose_tiles, load_tiles, render

FOLDER = Path(__file__).parent
_TILE, _ROWS, _COLUMNS = 0.585, 480, 640
_TO_SCALE, _PX = 8.43, 80  # metres a tile for Duckietown's proportions
_FULL_SIZE = 30.0  # metres a tile for cars and dashes of full size
_STREETS = FormatOptions(tile_size=_TO_SCALE)
_WIDE_STREETS = FormatOptions(tile_size=_FULL_SIZE, lane=12)
_SCALE = _PX / _TO_SCALE  # pixels to the metre
_BLUE, _WHITE, _YELLOW = (0, 220, 255), (255, 255, 255), (255, 220, 0)
_COMMONROAD = FOLDER.parent / ".venv-commonroad" / "bin" / "python"
_METADRIVE = FOLDER.parent / ".venv-metadrive" / "bin"
_PUFFERDRIVE = FOLDER.parent / ".venv-pufferdrive" / "pufferdrive_check"


def main() -> None:
    if find_spec("mujoco"):
        draw_mujoco()
    if find_spec("carla") and find_spec("sumo"):
        write_pair("networks.jpg", draw_carla(), draw_sumo())
    if find_spec("lanelet2") and _COMMONROAD.exists():
        write_pair("lanelets.jpg", draw_lanelet2(), draw_commonroad())
    if _METADRIVE.exists() and _PUFFERDRIVE.exists():
        write_pair("drivers.jpg", draw_metadrive(), draw_pufferdrive())


def draw_mujoco() -> None:
    """Draws a town and the robot from above, what its camera sees, and what ours sees there."""
    import mujoco

    town, tiles = read_map(FOLDER / "examples" / "town.json"), load_tiles()
    files = export(town, "mujoco", name="town")
    model = mujoco.MjModel.from_xml_string(files["town.xml"].decode(), assets={"town.png": files["town.png"]})
    data = mujoco.MjData(model)
    at = Pose(*jnp.array([3.3, 2.7, 0.0]))
    data.qpos[:2] = at.x * _TILE, (len(town.codes) - at.y) * _TILE
    data.qpos[3:7] = np.cos(at.theta / 2), 0, 0, np.sin(at.theta / 2)
    mujoco.mj_forward(model, data)
    above = mujoco.MjvCamera()
    above.lookat[:] = 2.05, 1.3, 0
    above.distance, above.azimuth, above.elevation = 4.2, 90, -50
    with mujoco.Renderer(model, _ROWS, _COLUMNS) as renderer:
        shown = []
        for camera in (above, "camera"):
            renderer.update_scene(data, camera)
            shown.append(renderer.render())
    sight = make_sight(tiles, Camera(rows=_ROWS, columns=_COLUMNS), tile_px=256)
    seen = look(at, town.codes, sight, chosen=choose_tiles(town.codes, tiles))
    gap = np.full((_ROWS, 12, 3), 255, np.uint8)
    row = np.hstack([shown[0], gap, shown[1], gap, np.asarray(seen.image)])
    half = cv2.resize(row, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    write("mujoco.jpg", np.asarray(half, np.uint8))


def draw_carla() -> NDArray[np.uint8]:
    """Draws CARLA's waypoints as lines along its lanes, white in junctions, and its landmarks: signs, and lights."""
    import carla

    town = furnish(read_map(FOLDER / "examples" / "town.json"), "signs lights=0.4")
    image, pixel = floor(town)
    city = carla.Map("town", export(town, "opendrive", _STREETS)["map.xodr"].decode())
    for point in city.generate_waypoints(0.5):
        start, ahead = point.transform.location, point.transform.get_forward_vector()
        colour = _WHITE if point.is_junction else _BLUE
        cv2.line(image, pixel(start.x, -start.y), pixel(start.x + 0.35 * ahead.x, -start.y - 0.35 * ahead.y), colour, 2)
    for one in city.get_all_landmarks():  # CARLA's y is south
        place, colour = one.transform.location, (255, 60, 220) if one.is_dynamic else (255, 140, 40)
        cv2.circle(image, pixel(place.x, -place.y), 5, colour, -1, cv2.LINE_AA)
    return image


def draw_sumo() -> NDArray[np.uint8]:
    """Draws SUMO's cars, two minutes after the first one."""
    from sumo import SUMO_HOME

    town = read_map(FOLDER / "examples" / "town.json")
    image, pixel = floor(town)
    with TemporaryDirectory() as folder:
        write_network(folder, town, _STREETS)
        bots = '<additional><vType id="DEFAULT_VEHTYPE" length="2.6" width="1.8" minGap="1"/></additional>'
        Path(folder, "bots.xml").write_text(bots)
        for command in (
            f"{SUMO_HOME}/bin/netconvert -c net.netccfg -o net.xml",
            f"{sys.executable} {SUMO_HOME}/tools/randomTrips.py -n net.xml -o trips.xml --seed 1 --end 120 --period 4",
            f"{SUMO_HOME}/bin/sumo -n net.xml -r trips.xml -a bots.xml --end 121 --device.fcd.begin 120 --fcd-output "
            "places.xml",
        ):
            subprocess.run(command.split(), cwd=folder, check=True, stdout=subprocess.DEVNULL)
        cars = list(ET.parse(Path(folder, "places.xml")).iter("vehicle"))
    for car in cars:
        x, y, angle = (float(car.attrib[key]) for key in ("x", "y", "angle"))
        ahead = 1j * np.exp(-1j * np.radians(angle))  # clockwise from north; x and y are those of the front
        corners = x + 1j * y + ahead * np.array([-0.9j, 0.9j, 0.9j - 2.6, -0.9j - 2.6])
        cv2.fillConvexPoly(image, np.array([pixel(one.real, one.imag) for one in corners]), _YELLOW, cv2.LINE_AA)
    return image


def draw_lanelet2() -> NDArray[np.uint8]:
    """Draws the bounds of Lanelet2's lanelets, and in yellow a route that its graph finds."""
    import lanelet2

    town = read_map(FOLDER / "examples" / "town.json")
    image, pixel = floor(town)
    with TemporaryDirectory() as folder:
        file = Path(folder, "town.osm")
        file.write_bytes(export(town, "lanelet2", _STREETS)["map.osm"])
        city = lanelet2.io.load(str(file), lanelet2.projection.UtmProjector(lanelet2.io.Origin(0, 9)))
    rules = lanelet2.traffic_rules.create("de", "vehicle")
    lanelets = {lanelet.attributes["name"]: lanelet for lanelet in city.laneletLayer}
    first, *_, last = lanelets.values()
    route = lanelet2.routing.RoutingGraph(city, rules).getRoute(first, last, 0).shortestPath()
    shown = image.copy()
    for lanelet in route:
        outline = [pixel(point.x, point.y) for point in lanelet.polygon2d()]
        cv2.fillPoly(shown, [np.array(outline)], _YELLOW, cv2.LINE_AA)
    image[:] = cv2.addWeighted(image, 0.4, shown, 0.6, 0)
    for lanelet in lanelets.values():
        for bound in (lanelet.leftBound, lanelet.rightBound):
            points = np.array([pixel(point.x, point.y) for point in bound])
            cv2.polylines(image, [points], False, _BLUE, 1, cv2.LINE_AA)
    return image


def draw_commonroad() -> NDArray[np.uint8]:
    """Returns the picture of CommonRoad's own renderer: lanelets, and the start and goal of the planning problem."""
    town = read_map(FOLDER / "examples" / "town.json")
    height, width = town.codes.shape
    with TemporaryDirectory() as folder:
        file, picture = Path(folder, "town.xml"), Path(folder, "town.png")
        file.write_bytes(export(town, "commonroad", _WIDE_STREETS)["map.xml"])
        size = [str(width * _FULL_SIZE), str(height * _FULL_SIZE), str(width * _PX)]
        script = FOLDER.parent / "tests" / "formats" / "commonroad_draws.py"
        subprocess.run([_COMMONROAD, script, file, *size, picture], check=True)
        image = cv2.imread(str(picture))
    assert image is not None
    return np.ascontiguousarray(image[..., ::-1], np.uint8)


def draw_metadrive() -> NDArray[np.uint8]:
    """Draws where two cars of MetaDrive's IDM policy were, once a second."""
    town = read_map(FOLDER / "examples" / "town.json")
    image, _ = floor(town)
    middle = np.array(town.codes.shape[::-1]) / 2
    with TemporaryDirectory() as folder:
        write_network(folder, town, _WIDE_STREETS)
        Path(folder, "net.xodr").write_bytes(export(town, "opendrive", _WIDE_STREETS)["map.xodr"])
        subprocess.run([_METADRIVE / "netconvert", "-c", "net.netccfg"], cwd=folder, check=True, capture_output=True)
        script = FOLDER.parent / "tests" / "formats" / "metadrive_reads.py"
        command = [str(_METADRIVE / "python"), str(script), "1", str(Path(folder, "net"))]
        printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    for track, colour in zip(json.loads(last_line(printed))["tracks"], (_BLUE, _YELLOW), strict=True):
        for place in track[::10]:
            # MetaDrive's origin is the middle of the map, and y is north.
            column, row = middle + np.array(place) * [1, -1] / _FULL_SIZE
            cv2.circle(image, (round(column * _PX), round(row * _PX)), 4, colour, -1, cv2.LINE_AA)
    return image


def draw_pufferdrive() -> NDArray[np.uint8]:
    """Draws PufferDrive's cars at the start, and the lanes between which it found links, white in crossings."""
    town = read_map(FOLDER / "examples" / "town.json")
    image, pixel = floor(town)
    files = export(town, "pufferdrive", _STREETS)
    with TemporaryDirectory() as folder:
        file = Path(folder, "town.bin")
        file.write_bytes(files["map.bin"])
        command = [str(_PUFFERDRIVE), "1", str(file)]
        state = json.loads(last_line(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
    roads = json.loads(files["map.json"])["roads"]
    for index in sorted({index for link in state["links"] for index in link}):
        places = [(place["x"], place["y"]) for place in roads[index]["geometry"]]
        x, y = places[len(places) // 2]
        code = town.codes[int(len(town.codes) - y / _TO_SCALE), int(x / _TO_SCALE)]
        colour = _WHITE if int(code).bit_count() > 2 else _BLUE
        cv2.polylines(image, [np.array([pixel(*place) for place in places])], False, colour, 2, cv2.LINE_AA)
    for x, y, heading in state["cars"]:
        corners = x + 1j * y + np.exp(1j * heading) * np.array([1.3 + 0.9j, 1.3 - 0.9j, -1.3 - 0.9j, -1.3 + 0.9j])
        cv2.fillConvexPoly(image, np.array([pixel(one.real, one.imag) for one in corners]), _YELLOW, cv2.LINE_AA)
    return image


def last_line(text: str) -> str:
    return text.strip().splitlines()[-1]


def write_network(folder: str, town: RoadMap, streets: FormatOptions) -> None:
    """Writes the files of which SUMO's netconvert makes a network."""
    for name, content in export(town, "sumo", streets, name="net").items():
        Path(folder, name).write_bytes(content)


def floor(town: RoadMap) -> tuple[NDArray[np.uint8], Callable[[float, float], tuple[int, int]]]:
    """Returns a picture of a map, and where places in it are, in metres east and north of its south-west corner."""
    image = np.ascontiguousarray(render(town.codes, tile_px=_PX).image)
    return image, lambda east, north: (round(east * _SCALE), round(len(image) - north * _SCALE))


def write_pair(name: str, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> None:
    gap = np.full((len(left), 12, 3), 255, np.uint8)
    write(name, np.hstack([left, gap, right]))


def write(name: str, image: NDArray[np.uint8]) -> None:
    cv2.imwrite(str(FOLDER / name), image[..., ::-1])


if __name__ == "__main__":
    main()

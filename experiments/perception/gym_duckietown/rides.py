"""A network drives in gym-duckietown's physics: it sees a picture, and pure pursuit follows the lane it finds.

    python -m experiments.perception.gym_duckietown.rides WEIGHTS --out FILE [--part test] [--seconds 60]

With `--policy`, the network chooses the speed and the turn, see `policy`. WEIGHTS may also be a `pose.onnx` of
`export_onnx`. Then `robot_node` drives, by this file alone.

Physics have 30 steps a second, the network sees every second one. A ride ends when the robot leaves the drivable tiles
or hits an object. FILE keeps each finished ride: after an interruption, the same command continues.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

from elitelanes_jax import InputError
from elitelanes_jax.drive import Pose, lane_pose
from experiments.common import Parser, Untyped, leave, require, run, table, whole, write
from experiments.perception.gym_duckietown.nets import COLUMNS, ROWS, choose_actions, find_poses, read_weights
from experiments.perception.gym_duckietown.pictures import TILE, shrink
from experiments.perception.gym_duckietown.policy import to_motion
from experiments.perception.gym_duckietown.world import World, random_poses, read_maps

__all__ = ["follow", "main", "read_driver", "ride", "ride_on_map"]

Driver = Callable[[dict[str, Untyped]], Float[NDArray, "2"]]
"""Returns the commands of both wheels for an answer of the bridge."""

_FRAMES, _RATE = 2, 30
_SPEED, _LOOKAHEAD = 0.25, 0.2  # metres a second, metres
_SLOWING = 0.2  # metres. In a model of the physics with errors of 3 cm and 0.2 rad, 100 % of rides stay, without 95 %.
_FORWARD, _TURN = 0.3, 3.75  # metres and radians a second, of the sum and the difference of commands at rest


def follow(lane: Float[NDArray, "3"]) -> Float[NDArray, "2"]:
    """Returns the commands of the wheels that lead to a point of the lane ahead, by pure pursuit, slower in bends."""
    d, phi, curvature = lane[0] * TILE, lane[1], lane[2] / TILE
    angle = curvature * _LOOKAHEAD
    ahead = _LOOKAHEAD * np.sinc(angle / np.pi)
    beside = _LOOKAHEAD * np.sin(angle / 2) * np.sinc(angle / 2 / np.pi) - d
    left = beside * np.cos(phi) - ahead * np.sin(phi)
    bend = 2 * left / (ahead**2 + beside**2)
    speed = _SPEED / (1 + _SLOWING * abs(bend))
    return _wheels(speed, speed * bend)


def _wheels(speed: float, turn: float) -> Float[NDArray, "2"]:
    both, apart = speed / _FORWARD, turn / _TURN
    return np.array([both - apart, both + apart]) / 2


def ride(
    world: World,
    start: Float[NDArray, "3"],
    codes: NDArray[np.int8],
    driver: Driver,
    seconds: float,
    pause: int = _RATE // _FRAMES,
) -> tuple[dict[str, float], list[UInt8[NDArray, "480 640 3"]], list[Float[NDArray, "3"]]]:
    """Drives from a pose; returns what happened, every picture after a `pause`, and the poses of these pictures.

    A pause of 15 pictures is a second.

    The table has the seconds until the robot left the road or hit something, the metres, and the share of the time in
    the oncoming lane.
    """
    seen = world.ask("start", pose=start)
    metres, oncoming, images, poses = 0.0, 0, list[NDArray[np.uint8]](), list[NDArray[np.float64]]()
    steps = round(seconds * _RATE / _FRAMES)
    for step in range(steps):
        if step % pause == 0:
            images.append(seen["image"])
            poses.append(seen["pose"])
        before = seen["pose"]
        seen = world.ask("step", action=driver(seen), frames=_FRAMES)
        metres += float(np.hypot(*(seen["pose"] - before)[:2])) * TILE
        oncoming += bool(_nearest(codes, np.float32(seen["pose"])).oncoming)
        if seen["hit"] or not seen["on_road"]:
            break
    lasted, on_road, no_hit = (step + 1) * _FRAMES / _RATE, bool(seen["on_road"]), not seen["hit"]
    about = {"seconds": lasted, "on_road": float(on_road), "no_hit": float(no_hit), "metres": metres}
    about["oncoming"] = oncoming / (step + 1)
    return about, images, poses


@jax.jit
def _nearest(codes: NDArray[np.int8], pose: Float[NDArray, "3"]) -> Untyped:
    return lane_pose(codes, Pose(*pose))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("rides", __doc__)
    parser.add_argument("weights", type=Path, help="file of train, of policy, or of export_onnx")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="rides, .json")
    parser.add_argument("--part", choices=("development", "test"), default="test")
    parser.add_argument("--seconds", type=whole(1, 600), default=60, metavar="S", help="of a ride; default 60")
    parser.add_argument("--domain-rand", action="store_true", help="with gym-duckietown's random light and camera")
    parser.add_argument("--policy", action="store_true", help="the weights are those of a policy")
    parser.add_argument("--only", choices=("people", "towns"), help="people's maps, or our towns; default both")
    options = parser.parse_args(arguments)
    return run("rides", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    settings = {name: str(value) for name, value in vars(options).items() if name != "out"}
    kept = json.loads(options.out.read_text(encoding="utf-8")) if options.out.exists() else {"settings": settings}
    if kept["settings"] != settings:
        raise InputError(options.out, "rides with the same options", kept["settings"])
    driver = read_driver(options.weights, policy=options.policy)
    with World() as world:
        for place in read_maps(options.part, options.only):
            if place.name not in kept:
                about = world.load(place, domain_rand=options.domain_rand)
                start = random_poses(place.codes, 1, 7)[0]
                found, *_ = ride(world, start, place.codes, driver, options.seconds)
                kept[place.name] = {"objects": len(about["objects"]), "rides": [found]}
                write(options.out, json.dumps(kept, indent=1))
                print(place.name, kept[place.name], flush=True)
    print(report({name: found for name, found in kept.items() if name != "settings"}))


def ride_on_map(
    name: str, driver: Driver, seconds: float, pause: int
) -> tuple[NDArray[np.int8], dict[str, float], list[UInt8[NDArray, "480 640 3"]], list[Float[NDArray, "3"]]]:
    """Drives on one of people's maps in maps.toml; returns the map's codes, and what `ride` returns."""
    maps = {place.name: place for part in ("development", "test") for place in read_maps(part, "people")}
    if name not in maps:
        raise InputError("map", f"one of {', '.join(maps)}", repr(name))
    place = maps[name]
    with World() as world:
        world.load(place)
        start = random_poses(place.codes, 1, 7)[0]
        return place.codes, *ride(world, start, place.codes, driver, seconds, pause)


def read_driver(file: Path, *, policy: bool) -> Driver:
    """Reads a driver that follows the lane that a network finds in the picture, or does what a policy chooses."""
    if file.suffix == ".onnx":
        return _read_pilot(file, policy=policy)
    weights = read_weights(file, "policy" if policy else "pose")

    def drive(seen: dict[str, Untyped]) -> Float[NDArray, "2"]:
        image = shrink(seen["image"][None])
        if not policy:
            return follow(np.asarray(find_poses(weights, image)[0], float))
        speed, turn = to_motion(choose_actions(weights, image)[0])
        return _wheels(float(speed), float(turn))

    return drive


def _read_pilot(file: Path, *, policy: bool) -> Driver:
    require("rides by an ONNX file need", "onnxruntime")
    from experiments.perception.gym_duckietown.robot_node import Pilot

    if policy:
        raise InputError(file, "weights of policy", "an ONNX file")
    try:
        pilot = Pilot(str(file))
        pilot(np.zeros((ROWS, COLUMNS, 3), np.uint8))
    except Exception as error:  # onnxruntime's errors have no class of their own
        raise InputError(file, "a file of export_onnx pose", error) from None
    return lambda seen: pilot(seen["image"])[1]


def report(kept: dict[str, Untyped]) -> str:
    """Returns a table of rides on people's maps with and without objects, and on our towns."""
    groups: dict[str, list[dict[str, float]]] = {}
    for name, found in kept.items():
        ours = name.startswith("town ")
        group = "our towns" if ours else "people's maps, objects" if found["objects"] else "people's maps, no objects"
        groups.setdefault(group, []).extend(found["rides"])
    rows = []
    for group, rides in groups.items():
        on_road, no_hit, own = (
            np.mean(part)
            for part in (
                [one["on_road"] for one in rides],
                [one["on_road"] * one["no_hit"] for one in rides],
                [one["on_road"] and one["oncoming"] == 0 for one in rides],
            )
        )
        metres = sum(one["metres"] for one in rides) / sum(one["seconds"] for one in rides) * 60
        rows.append([group, str(len(rides)), f"{on_road:.0%}", f"{no_hit:.0%}", f"{own:.0%}", f"{metres:.1f}"])
    head = ["maps", "rides", "stay on the road", "and hit nothing", "never in the oncoming lane", "metres a minute"]
    return table(head, rows)


if __name__ == "__main__":
    leave(main())

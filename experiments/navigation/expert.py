"""How many routes the expert of `LaneDrive` drives to their goals without leaving its lane.

python -m experiments.navigation.expert [--human-made FOLDER] [--maps N]

It drives on drawn maps, on maps that keep Duckietown's rules, and on the maps in a folder of Duckietown's YAML files,
such as ``src/duckietown_world/data/gd1/maps`` of duckietown-world-daffy: from many starts to goals drawn at random.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool
from numpy.typing import NDArray

from elitelanes_jax import InputError, random_grids, repair
from elitelanes_jax.drive import LaneDrive, LaneDriveParams, make_levels, movements, pure_pursuit
from elitelanes_jax.formats import from_duckietown, without_dead_ends
from experiments.common import Parser, Pytree, leave, run, whole

__all__ = ["drive_all", "human_made", "main"]

ROUTES = 25  # on each map made by people


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("expert", __doc__)
    parser.add_argument("--human-made", type=Path, metavar="FOLDER", help="a folder of Duckietown's YAML files")
    parser.add_argument("--maps", type=whole(1), default=1000, metavar="N", help="of each kind; default 1000")
    options = parser.parse_args(arguments)
    return run("expert", lambda: _count(options))


def _count(options: argparse.Namespace) -> None:
    drawn = random_grids(jax.random.key(7), options.maps, (8, 8))
    filled = jax.jit(jax.vmap(partial(repair, fill=True)))(drawn)
    ruled = np.stack([without_dead_ends(grid) for grid in np.asarray(jax.jit(jax.vmap(repair))(drawn))])
    print("| maps | routes | driven in the lane |\n|---|---:|---:|")
    for name, grids in (("drawn", np.asarray(filled)), ("Duckietown's rules", ruled)):
        print(f"| {options.maps} {name} | {options.maps} | {drive_all(grids, options.maps).sum()} |")
    if options.human_made is None:
        return
    made, left_out = human_made(options.human_made)
    driven = drive_all(made, ROUTES * len(made))
    print(f"| {len(made)} made by people | {driven.size} | {driven.sum()} |")
    print(f"left out: {', '.join(f'{name} ({why})' for name, why in left_out.items()) or 'none'}")


def human_made(folder: Path) -> tuple[NDArray[np.int8], dict[str, str]]:
    """Reads the maps in a folder of Duckietown's YAML files, on grids of one size, int8 ``[N, H, W]``.

    Returns:
      The maps, and by file why others are none of them.

    Raises:
      InputError: if there is no map.
    """
    found, left_out = list[NDArray[np.int8]](), dict[str, str]()
    for file in sorted(folder.glob("*.yaml")):
        try:
            grid = from_duckietown(file.read_text(encoding="utf-8"))
        except InputError as error:
            left_out[file.stem] = str(error)
            continue
        if np.asarray(movements(grid)).any():
            found.append(grid)
        else:
            left_out[file.stem] = "no lane"
    if not found:
        raise InputError(f"--human-made: expected a folder of Duckietown's maps, got {folder}")
    height, width = np.max([grid.shape for grid in found], axis=0)
    padded = [np.pad(grid, ((0, height - grid.shape[0]), (0, width - grid.shape[1]))) for grid in found]
    return np.stack(padded), left_out


def drive_all(grids: NDArray[np.int8], count: int) -> NDArray[np.bool_]:
    """Tells which of so many routes the expert drives to the goal within its lane: bool ``[count]``."""
    levels = make_levels(jax.random.key(8), grids, count)
    longest = int(np.max(np.asarray(levels.shortest)))
    # A tile takes at most 1.1 tiles of lane, at 0.3 m/s.
    return np.asarray(_drive(LaneDriveParams(levels, limit=10**6), 66 * (longest + 2)))


@jax.jit
def _drive(params: LaneDriveParams, steps: int) -> Bool[Array, " N"]:
    count = params.levels.grid.shape[0]
    step = jax.vmap(LaneDrive.step, in_axes=(0, 0, 0, None))
    keys = jax.random.split(jax.random.key(9), count)
    _, first = jax.vmap(LaneDrive.reset_to_level, in_axes=(0, 0, None))(keys, params.levels, params)

    def go(carry: tuple[Array, Pytree, Array, Array]) -> tuple[Array, Pytree, Array, Array]:
        number, state, kept, arrived = carry
        done = step(keys, state, jax.vmap(lambda one: pure_pursuit(one, params))(state), params)
        return number + 1, done.state, kept & (done.info.own_lane | arrived), arrived | (kept & done.info.success)

    def goes_on(carry: tuple[Array, Pytree, Array, Array]) -> Bool[Array, ""]:
        number, _, kept, arrived = carry
        return (number < steps) & (kept & ~arrived).any()

    nobody = jnp.zeros(count, bool)
    return jax.lax.while_loop(goes_on, go, (jnp.int32(0), first, ~nobody, nobody))[3]


if __name__ == "__main__":
    leave(main())

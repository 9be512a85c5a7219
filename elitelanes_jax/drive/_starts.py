"""The starts of LaneDrive: poses near the middle of a lane, which touch no object if possible."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from elitelanes_jax.drive._courses import TileReader, choose_turn
from elitelanes_jax.drive._lane_drive_records import LaneDriveParams, Parts
from elitelanes_jax.drive._objects import Objects, stands_on
from elitelanes_jax.drive.lanes import lane_length, lane_point, wrap_angle
from elitelanes_jax.lanes.movements import LaneNode, Movement
from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.network.xla import rounded

# The places, evenly along the lane of a tile, at which a start that touches no object is sought.
_PLACES = 8


def draw_bits(key: Array, params: LaneDriveParams) -> Array:
    """Draws all bits of a reset at once.

    There is a word for the level, two words for the start, and one for each random turn.
    """
    return random_bits(key, (5,) if params.task == "lane" else (3,))


def draw_start(
    bits: Array, node: LaneNode, read: TileReader, objects: Objects | None, params: LaneDriveParams
) -> Parts:
    """Returns the parts of a state that a start at a node decides, from bits of `draw_bits`."""
    # A share needs 16 bits. One word has two of them.
    along, beside, turned = (
        (word & 0xFFFF).astype(jnp.float32) / 2**16 for word in (bits[1], bits[1] >> 16, bits[2])
    )
    # With task "lane" these words are used for the turns alone. Otherwise no turn is random.
    turn = choose_turn(bits[-1], read, node, params)
    movement = Movement(*node, turn)
    # The robot starts in the first half of its tile.
    length = lane_length(turn, params.lane_offset)
    s = along * length / 2
    d = rounded((2 * beside - 1) * params.start_d)
    if objects is not None:
        s = _find_free_place(s, length, d, movement, objects, params)
    phi = rounded((2 * turned - 1) * params.start_phi)
    pose = lane_point(movement, s, d, params.lane_offset)
    return {
        "pose": pose._replace(theta=wrap_angle(pose.theta + phi)),
        "movement": movement,
        "next_turn": choose_turn(bits[-2], read, movement.next_node, params),
        "d": jnp.asarray(d, jnp.float32),
        "phi": jnp.asarray(phi, jnp.float32),
        "s": s,
    }


def _find_free_place(
    s: Array,
    length: Array,
    d: Array,
    movement: Movement,
    objects: Objects,
    params: LaneDriveParams,
) -> Array:
    """Returns the first of a few places along a lane where the robot touches no object.

    The first place is `s`. The places after the end of the lane continue from its start. Returns
    `s` if no place is free.
    """
    # `s` is a product, and is rounded before the sum as `rounded` says. The first place is `s`
    # itself.
    steps = rounded(length * (np.arange(1, _PLACES, dtype=np.float32) / _PLACES))
    further = rounded(s) + steps
    further = jnp.where(further < length, further, further - length)
    places = jnp.concatenate([s[None], further])
    poses = lane_point(movement, places, d, params.lane_offset)
    is_free = ~jax.vmap(partial(stands_on, objects, radius=params.robot.width / 2))(poses)
    return places[jnp.argmax(is_free)]

"""Who goes first where the ways of robots across a tile conflict: rules as data."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, one_of, whole
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import Untyped, UserValue
from elitelanes_jax.lanes.movements import EXIT, TURNS

RULES = ("allway_stop", "right_before_left", "traffic_light")
"""The names of `traffic_rule`, which are also those of SUMO."""

# A way across a tile has the number heading * 3 + turn.
_WAYS = len(EXIT) * len(TURNS)

_MOST_STEPS = 2**20


class TrafficRule(NamedTuple):
    """Who goes first on a tile. `traffic_rule` makes one, and `_replace` changes it.

    A way across a tile has the number heading * 3 + turn.

    Attributes:
      yields: bool ``[12, 12]``, whether the first way gives way to the second one; False on the
        diagonal.
      by_arrival: bool, whether a robot gives way only to robots that came to their line earlier.
      green: bool ``[P, 4]``, whether robots may enter a crossing, by the phase and their heading.
      phase_steps: int32, the steps of each phase, 1 to 1,048,576.
    """

    yields: Bool[ArrayLike, "12 12"]
    by_arrival: Bool[ArrayLike, ""]
    green: Bool[ArrayLike, "P 4"]
    phase_steps: Int[ArrayLike, ""]


@name_wrong_arguments
def traffic_rule(name: str, *, phase_steps: int = 4) -> TrafficRule:
    """Returns a rule by its name.

    Args:
      name: "allway_stop": of robots whose ways conflict, the one that came first goes first.
        "right_before_left": a robot gives way to the right, and before a left turn to robots ahead.
        "traffic_light": in addition, a crossing has green for north and south, then for nobody,
        then for east and west, then for nobody.
      phase_steps: the steps of a phase of the lights, 1 to 1,048,576. The other rules have no
        lights, and phases that are all green.

    Raises:
      InputError: for another name, or a number out of its range.
    """
    check_named("name", one_of(*RULES), name)
    steps = check_named("phase_steps", whole(1, _MOST_STEPS), phase_steps)
    by_arrival = name == "allway_stop"
    yields = _conflicts() if by_arrival else _conflicts() & _has_priority()
    # All rules have four phases, so that arrays of rules can be stacked.
    green = np.ones((4, 4), bool)
    if name == "traffic_light":
        green = np.array([[1, 0, 1, 0], [0, 0, 0, 0], [0, 1, 0, 1], [0, 0, 0, 0]], bool)
    return TrafficRule(yields, np.bool_(by_arrival), green, np.int32(steps))


def _conflicts() -> Bool[np.ndarray, "12 12"]:
    """Returns which ways across a tile cross or meet."""
    heading, turn = np.divmod(np.arange(_WAYS), len(TURNS))
    # Eight points around the tile, clockwise: each side has one where ways enter, and then one where
    # they leave. A way enters by the side opposite to its heading.
    enters = 2 * ((heading + 2) % 4)
    leaves = 2 * EXIT[heading, turn] + 1

    def is_between(points: np.ndarray) -> Bool[np.ndarray, "12 12"]:
        """Returns whether the second way's point lies clockwise between both points of the first."""
        return (points - enters[:, None]) % 8 < (leaves - enters)[:, None] % 8

    crosses = is_between(enters) != is_between(leaves)
    meets = leaves[:, None] == leaves
    return (enters[:, None] != enters) & (crosses | meets)


def _has_priority() -> Bool[np.ndarray, "12 12"]:
    """Returns whether the second way comes from the right, or towards a first way that turns left."""
    heading, turn = np.divmod(np.arange(_WAYS), len(TURNS))
    heading_between = (heading - heading[:, None]) % 4
    left = TURNS.index("left")
    is_oncoming = (heading_between == 2) & (turn[:, None] == left) & (turn != left)
    return (heading_between == 3) | is_oncoming


def check_rule(rule: UserValue) -> TrafficRule:
    """Returns a rule that is given as a rule or by its name; raises `InputError`."""
    if isinstance(rule, str):
        one_of(*RULES)(rule)
        return traffic_rule(rule)
    if not isinstance(rule, TrafficRule):
        expected = f"a TrafficRule, or one of {', '.join(RULES)}"
        raise InputError("", expected, quote(rule))
    arrays = [_to_array(part) for part in rule]
    yields, by_arrival, green, steps = arrays
    if yields.shape != (_WAYS, _WAYS) or not _is_of(yields, jnp.bool_):
        raise InputError("yields", "bool [12, 12]", quote(rule.yields))
    if not isinstance(yields, jax.core.Tracer) and np.diagonal(yields).any():
        raise InputError("yields", "False for a way and itself", "True on the diagonal")
    if by_arrival.shape != () or not _is_of(by_arrival, jnp.bool_):
        raise InputError("by_arrival", "bool []", quote(rule.by_arrival))
    if green.shape[1:] != (4,) or not green.size or not _is_of(green, jnp.bool_):
        raise InputError("green", "bool [P, 4]", quote(rule.green))
    is_integer = steps.shape == () and _is_of(steps, jnp.integer)
    # The number of a tracer is not known.
    is_known = is_integer and not isinstance(steps, jax.core.Tracer)
    if not is_integer or (is_known and not 1 <= np.asarray(steps) <= _MOST_STEPS):
        expected = f"a whole number, 1 to {_MOST_STEPS}"
        raise InputError("phase_steps", expected, quote(rule.phase_steps))
    return TrafficRule(*map(frozen_copy, arrays))


def _to_array(value: Untyped) -> Untyped:
    """Returns numbers and lists as an array of NumPy, and an array unchanged."""
    if hasattr(value, "dtype"):
        return value
    try:
        return np.asarray(value)
    except ValueError:
        # The lists have several lengths. No check accepts this array.
        return np.asarray(None)


def _is_of(array: Untyped, kind: Untyped) -> bool:
    return jnp.issubdtype(array.dtype, kind)


def way_number(heading: Array, turn: Array) -> Array:
    """Returns the number of a way across a tile."""
    return heading * len(TURNS) + turn

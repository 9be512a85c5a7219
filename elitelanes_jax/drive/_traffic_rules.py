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
      by_arrival: bool, whether it gives way only to robots that came to their line earlier.
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
    _check_flags("yields", rule.yields, _shape(rule.yields) == (_WAYS, _WAYS), "12, 12")
    if not isinstance(rule.yields, jax.core.Tracer) and np.diagonal(rule.yields).any():
        raise InputError("yields", "False for a way and itself", "True on the diagonal")
    _check_flags("by_arrival", rule.by_arrival, _shape(rule.by_arrival) == (), "")
    phases, *headings = _shape(rule.green) or [0]
    _check_flags("green", rule.green, phases > 0 and headings == [4], "P, 4")
    steps = rule.phase_steps
    is_integer = _shape(steps) == () and jnp.issubdtype(jnp.result_type(steps), jnp.integer)
    # The number of a tracer is not known.
    is_known = is_integer and not isinstance(steps, jax.core.Tracer)
    if not is_integer or (is_known and not 1 <= np.asarray(steps) <= _MOST_STEPS):
        expected = f"a whole number, 1 to {_MOST_STEPS}"
        raise InputError("phase_steps", expected, quote(steps))
    return TrafficRule(*map(frozen_copy, rule))


def _shape(value: Untyped) -> tuple[int, ...] | None:
    """Returns the shape of an array; None for lists of several lengths."""
    try:
        return np.shape(value)
    except ValueError:
        return None


def _check_flags(name: str, array: UserValue, has_shape: bool, shape: str) -> None:
    if not has_shape or not jnp.issubdtype(jnp.result_type(array), jnp.bool_):
        raise InputError(name, f"bool [{shape}]", quote(array))


def way_number(heading: Array, turn: Array) -> Array:
    """Returns the number of a way across a tile."""
    return heading * len(TURNS) + turn

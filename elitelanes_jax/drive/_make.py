"""Environments by name, with levels on given maps."""

import jax

from elitelanes_jax._util.checks import check_named, one_of, whole
from elitelanes_jax._util.types import AnyArray, UserValue
from elitelanes_jax.drive._environment import Environment
from elitelanes_jax.drive._lane_drive import LaneDrive, LaneDriveParams
from elitelanes_jax.drive._levels import make_levels
from elitelanes_jax.drive._road_nav import RoadNav, RoadNavParams

_ENVIRONMENTS = {"RoadNav": (RoadNav, RoadNavParams), "LaneDrive": (LaneDrive, LaneDriveParams)}


def make(
    name: str, maps: AnyArray, *, count: int = 256, seed: int = 0, **settings: UserValue
) -> tuple[Environment, RoadNavParams | LaneDriveParams]:
    """Returns an environment and its parameters, with random levels on the maps.

    Args:
      name: "RoadNav" or "LaneDrive".
      maps: a `RoadMap`, several of one size, or integer codes ``[M, H, W]``.
      count: the number of levels. Level i is on map i modulo M.
      seed: of the levels, 0 or more.
      settings: fields of `RoadNavParams` or `LaneDriveParams`, such as ``limit``.

    Raises:
      InputError: for another name, and as `make_levels` and the parameters do.
    """
    environment, params = _ENVIRONMENTS[check_named("name", one_of(*_ENVIRONMENTS), name)]
    key = jax.random.key(check_named("seed", whole(0, 2**32 - 1), seed))
    return environment, params(make_levels(key, maps, count), **settings)

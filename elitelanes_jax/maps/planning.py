"""From a specification to a planned run, before JAX is imported.

The tiles are read, and the search is resolved.
"""

from typing import NamedTuple

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.types import Plain
from elitelanes_jax.maps.furnishing.spec import AS_MANY_AS_FIT, FurnishSpec
from elitelanes_jax.maps.spec import GenerateSpec
from elitelanes_jax.network.codes import CROSSINGS
from elitelanes_jax.search.resolve import Search, resolve
from elitelanes_jax.search.spec import SearchSpec
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

# A map may have no crossing if one of these features is at most this value. A single ring, for
# example, has the cyclomatic number 1.
_WITHOUT_CROSSING = {"crossings": 0, "crossing_share": 0, "cyclomatic": 1}


class PlannedRun(NamedTuple):
    """A run of a specification.

    Attributes:
      spec: the specification of the search and the folder.
      search: resolved on the size of the maps, with the alphabet of the tiles.
      tiles: the tile set to draw the maps with.
    """

    spec: GenerateSpec
    search: Search
    tiles: TileSet

    def identity(self) -> dict[str, Plain]:
        """Returns what the search depends on except its budget, plain values for JSON."""
        search = self.search.to_plain()
        # The budget is left out, because a search resumes with a larger one.
        del search["evaluations"], search["generations"]
        about = {name: getattr(self.spec, name) for name in ("size", "seeds", "seed", "part")}
        return {"command": "generate", **about, "search": search, "versions": installed_versions()}


def plan_run(spec: GenerateSpec) -> PlannedRun:
    """Loads the tiles of a run, and resolves its search.

    Raises:
      InputError: for constraints that no map can meet, objects that no map has room for, or a bad
        tile set.
    """
    tiles = load_tiles(spec.tiles)
    search = resolve_to_draw(spec.search, spec.size, tiles)
    if spec.furnish is not None:
        check_furnishable(spec.furnish, search)
    return PlannedRun(spec, search, tiles)


def resolve_to_draw(spec: SearchSpec, shape: tuple[int, int], tiles: TileSet) -> Search:
    """Resolves a search for maps that can be drawn with a tile set.

    Raises:
      InputError: if the user's alphabet has other codes than the tile set, or no map can meet the
        constraints.
    """
    # A search may use fewer codes than the tile set has, but no others.
    missing = set(spec.options.get("alphabet") or ()) - set(tiles.alphabet)
    if missing:
        codes = ", ".join(map(str, tiles.alphabet))
        raise InputError("alphabet", f"codes of the tile set {tiles.name!r}, {codes}", min(missing))
    return resolve(spec, shape, tiles.alphabet, room_for="maps")


def check_furnishable(furnish: FurnishSpec, search: Search) -> None:
    """Refuses objects for which no map of a search has room.

    Also refuses signs for which some maps have no room.
    """
    settings = search.settings
    # With `signable=1` all crossings of a map have room for their signs.
    all_signable = any(item.name == "signable" and item.low == 1 for item in search.ranges)
    if (
        furnish.signs == "all"
        and settings.rules != "duckietown"
        and not all_signable
        and not _lacks_crossings(search)
    ):
        raise InputError(
            "furnish",
            (
                "rules=duckietown, or an inventory and where signable=1, with signs at every "
                "crossing"
            ),
            "neither",
            "signs=possible leaves out crossings that have a road at a corner",
        )
    # A search with fixed cells does not fill all cells: these may be empty, or leave free cells
    # empty between them.
    if furnish.numbers_beside_roads and search.fills_all_cells:
        asked = " ".join(
            f"{name}={amount:g}" for name, amount in furnish.numbers_beside_roads.items()
        )
        raise InputError(
            "furnish",
            f"rules=duckietown or a style such as town with {asked}",
            "a search whose maps have no cells without road",
            AS_MANY_AS_FIT,
        )


def _lacks_crossings(search: Search) -> bool:
    """Returns whether some maps may have no crossing, and need no sign.

    The limit of the size is a rule of thumb, because larger maps may also be a single ring.
    """
    if search.settings.fix is not None or sum(search.shape) <= 5:
        return True
    if set(CROSSINGS).isdisjoint(search.alphabet):
        return True
    for item in search.ranges:
        if item.high is not None and item.high <= _WITHOUT_CROSSING.get(item.name, -1):
            return True
    return False

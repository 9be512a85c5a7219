"""From maps to a pack for other programs and for learning.

A pack has the maps' files by niche, splits with held-out niches, and trips to drive.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypedDict

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.files import write_atomic, write_json
from elitelanes_jax._util.folders import foreign_file, output_folder
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress, announce_at_end
from elitelanes_jax._util.sums import SUMS, read_sealed_lines, read_sums, sealed_line, write_sums
from elitelanes_jax._util.types import OptionValue, Plain, UserValue
from elitelanes_jax.formats.road_map import RoadMap, map_to_json
from elitelanes_jax.formats.sumo import to_sumo_trips
from elitelanes_jax.formats.table import Row, shorten_coverage, table_to_csv
from elitelanes_jax.lanes.curves import LANE_OFFSET, lane_lengths
from elitelanes_jax.lanes.movements import LaneGraph, LaneNode, lane_graph
from elitelanes_jax.maps._splits import split_niches
from elitelanes_jax.maps.exporting import FORMATS, LOOP, lane_offset_of, without_ends
from elitelanes_jax.maps.faults import warn_of_faults
from elitelanes_jax.maps.given import parse_given
from elitelanes_jax.maps.spec import SPLITS, PackSpec
from elitelanes_jax.network.likeness import ALIKE, road_forms
from elitelanes_jax.network.plain_metrics import cut_to_roads

if TYPE_CHECKING:
    from elitelanes_jax.tiles.tileset import TileSet

RECORD = "pack.json"
"""The file with the settings of a pack."""

# The suffix of the files of SUMO's trips.
_ROUTES = ".rou.xml"

# The lengths that `_trips` keeps, 8 bytes each: 128 MiB.
_CACHED_LENGTHS = 2**24

# The features in the table of a pack's README.
_SHOWN = ("tiles", "crossings", "turns", "cyclomatic", "bridges", "dead_ends", "lanes", "trip")


class _Town(NamedTuple):
    """A map of a pack.

    Attributes:
      id: the id of the map, which is the same for all maps with its roads.
      niche: the name of its niche.
      split: the name of its split.
      road_map: the map.
    """

    id: str
    niche: str
    split: str
    road_map: RoadMap


class _PackedMaps(TypedDict):
    """The number of the maps of a pack, and a digest of them."""

    number: int
    digest: str


class _PackSource(TypedDict):
    """What a pack is made from."""

    settings: dict[str, Plain]
    maps: _PackedMaps
    versions: dict[str, str]


class _SplitSize(TypedDict):
    """The numbers of maps and of niches in a split."""

    maps: int
    niches: int


class PackRecord(_PackSource):
    """The record of a pack, in ``pack.json``: its source, and the sizes of its splits by name."""

    splits: dict[str, _SplitSize]


@name_wrong_arguments
def pack(spec: PackSpec, sources: UserValue, out: str | Path, *, force: bool = False) -> PackRecord:
    """Writes a pack of maps.

    The same maps and specification give the same files, byte for byte. If a run was killed, the
    same call resumes it.

    Args:
      spec: the specification of the pack.
      sources: a folder of `generate` or `pick`, a dataset, a pack, or maps in any form that
        `as_maps` takes; or several of these. Of maps whose roads are the same when moved, rotated
        or mirrored, the first one is packed.
      out: the folder, new or empty.
      force: whether another pack in the folder is replaced, if nothing else is in the folder.

    Returns:
      The record in ``pack.json``.

    Raises:
      InputError: for bad maps, one without lanes or that a format cannot hold, a setting that a
        format refuses, fewer niches than splits, also because their maps are alike, or a folder
        that may not be replaced.
      OSError: that names the file, if a file cannot be written. The same call resumes.
    """
    out = Path(check_named("out", path, out))
    settings = spec.formats.loaded()
    # Each format converts a small map that it can hold. A bad setting or a missing package raises
    # its error here, before the first map is written.
    for to in spec.to:
        FORMATS[to].files(LOOP, "map", **settings)
    tiles = settings.get("tiles")
    try:
        maps = parse_given(sources)
    except InputError as error:
        # Most errors name a file or a map.
        if error.subject:
            raise
        raise error.within("sources") from None
    towns = _split(spec, maps.maps)
    source: _PackSource = {
        "settings": spec.to_plain(),
        "maps": {"number": len(towns), "digest": maps.digest},
        "versions": installed_versions(),
    }
    # A run is resumed only if its identity is equal. The settings have the tile set's folder alone,
    # whose pictures may change between the runs, so the identity also has their digest.
    tile_set = None if tiles is None else tiles.to_plain()
    identity = {"command": "pack", **source, "tile_set": tile_set}
    inputs: list[str | Path] = [*maps.paths, *spec.inputs]
    with output_folder(
        out, identity, inputs=inputs, foreign=_foreign, force=force, resume_files=True
    ) as work:
        # A file in `kept` makes the next run resume with the files of this one.
        list_of_ids = work.kept / "maps.json"
        write_json(list_of_ids, [town.id for town in towns])
        journal = _Journal(work.files, work.kept / "files.jsonl")
        rows: list[Row] = []
        written: list[RoadMap] = []
        with Progress("packing", len(towns), "maps") as bar:
            for town, map_name in zip(towns, maps.names, strict=True):
                try:
                    road_map = without_ends(town.road_map, spec.formats.dead_ends)
                    rows.append(_write(spec, town, road_map, work.files, settings, journal))
                except InputError as error:
                    # The same map would fail again, so there is nothing to resume.
                    list_of_ids.unlink()
                    journal.file.unlink(missing_ok=True)
                    raise error.within(f"niche {town.niche}, {map_name}") from None
                written.append(road_map)
                bar.count()
        record: PackRecord = {**source, "splits": _write_splits(spec, towns, work.files)}
        write_atomic(work.files / "maps.csv", table_to_csv(rows).encode())
        write_json(work.files / RECORD, record)
        card = _card(spec, record, rows, lane_offset_of(tiles))
        write_atomic(work.files / "README.md", card.encode())
        write_sums(work.files)
    maps.announce_left_out()
    _announce_limits(spec, written, tiles)
    _warn_of_removed_roads(towns, written, maps.names)
    return record


def _announce_limits(spec: PackSpec, written: Sequence[RoadMap], tiles: "TileSet | None") -> None:
    """Says for each format how many maps have a part that its programs cannot use.

    The message describes the part that the first of these maps has.
    """
    for to in spec.to:
        # The first part of each map that has one. A map counts once.
        limits: list[str] = []
        for road_map in written:
            limits += spec.formats.limits(to, road_map, tiles)[:1]
        if limits:
            share = f"{len(limits)} of {pluralize(len(written), 'map')}"
            announce_at_end(to, f"{share}, the first: {limits[0]}")


def _warn_of_removed_roads(
    towns: Sequence[_Town], written: Sequence[RoadMap], names: Sequence[str]
) -> None:
    """Says which signs do not fit the roads after the removal of roads that lead nowhere."""
    for town, road_map, name in zip(towns, written, names, strict=True):
        if not np.array_equal(road_map.codes, town.road_map.codes):
            warn_of_faults(name, road_map)


def _split(spec: PackSpec, maps: Sequence[RoadMap]) -> list[_Town]:
    """Assigns whole niches to splits, see `split_niches`."""
    niches = [_name_niche(road_map) for road_map in maps]
    # Around the roads, people leave any number of empty rows and columns. With these, all small
    # maps in a large grid would be alike.
    codes = [cut_to_roads(road_map.codes) for road_map in maps]
    splits = split_niches(codes, niches, spec.split, spec.seed)
    towns = []
    for form, niche, split, road_map in zip(road_forms(codes), niches, splits, maps, strict=True):
        town_id = sha256(form).hexdigest()[:12]
        towns.append(_Town(town_id, niche, split, road_map))
    return towns


def _name_niche(road_map: RoadMap) -> str:
    """Returns the size of a map and its bins, such as 6x6-03-12."""
    size = "x".join(map(str, road_map.codes.shape))
    return size + "".join(f"-{part:02d}" for part in road_map.niche or ())


class _Journal:
    """The checksums of the files of formats that this run and earlier ones have written.

    After a loss of power, a file that exists may be empty.

    Args:
      folder: the folder of the pack's files.
      file: the file of the journal.
    """

    def __init__(self, folder: Path, file: Path) -> None:
        self.folder, self.file = folder, file
        lines = [*read_sealed_lines(file.read_bytes())] if file.exists() else []
        # The journal is written anew, because a line after a damaged one would be damaged too.
        write_atomic(file, map(sealed_line, lines))
        self._sums: dict[str, str] = {}
        for line in lines:
            self._sums |= json.loads(line)

    def has(self, files: Iterable[Path]) -> bool:
        """Returns whether all of some files were written and are not damaged."""
        return all(
            file.exists() and self._sums.get(self._name(file)) == _sum(file) for file in files
        )

    def add(self, files: Iterable[Path]) -> None:
        """Adds files that were written."""
        sums = {self._name(file): _sum(file) for file in files}
        with self.file.open("ab") as stream:
            stream.write(sealed_line(json.dumps(sums).encode()))

    def _name(self, file: Path) -> str:
        return file.relative_to(self.folder).as_posix()


def _sum(file: Path) -> str:
    return sha256(file.read_bytes()).hexdigest()


def _write(
    spec: PackSpec,
    town: _Town,
    written: RoadMap,
    folder: Path,
    settings: Mapping[str, OptionValue],
    journal: _Journal,
) -> Row:
    """Writes the files of a map; returns its row of the table.

    The files of a format are written only if the journal does not have all of them. `written` is
    the map as formats without dead ends have it. `settings` are those of all formats, with their
    tile set.
    """
    graph = lane_graph(town.road_map.codes)
    # A trip must not lead to a road that the formats lack.
    graph_of_trips = graph
    if written is not town.road_map:
        graph_of_trips = lane_graph(written.codes)
    trips = _trips(spec, town, graph_of_trips, lane_offset_of(settings.get("tiles")))
    _write_formats(spec, town, folder, settings, journal)
    map_file = folder / "maps" / town.niche / f"{town.id}.json"
    write_atomic(map_file, map_to_json(town.road_map).encode())
    trips_file = folder / "trips" / town.niche / f"{town.id}.csv"
    write_atomic(trips_file, table_to_csv(trips).encode())
    if "sumo" in spec.to:
        ends = [(_node(trip, "start"), _node(trip, "goal")) for trip in trips]
        # Formats of networks have dead ends, so SUMO's network is that of the whole map.
        routes = to_sumo_trips(town.road_map.codes, ends)
        write_atomic(folder / "sumo" / town.niche / f"{town.id}{_ROUTES}", routes.encode())
    return _row(town, len(graph.edges), trips)


def _write_formats(
    spec: PackSpec,
    town: _Town,
    folder: Path,
    settings: Mapping[str, OptionValue],
    journal: _Journal,
) -> None:
    """Writes the files of a map in all formats."""
    for to in spec.to:
        niche_folder = folder / to / town.niche
        files = [niche_folder / file for file in FORMATS[to].paths(town.id)]
        if journal.has(files):
            continue
        # A format whose settings remove dead ends does so itself.
        contents = FORMATS[to].files(town.road_map, town.id, **settings)
        for file, content in contents.items():
            write_atomic(niche_folder / file, content)
        journal.add(files)


def _row(town: _Town, lanes: int, trips: Sequence[Row]) -> Row:
    """Returns the row of a map in the table of maps."""
    height, width = town.road_map.codes.shape
    mean_trip = float(np.mean([trip["length"] for trip in trips]))
    columns: Row = {
        "id": town.id,
        "niche": town.niche,
        "split": town.split,
        "height": height,
        "width": width,
        "lanes": lanes,
        "trip": round(mean_trip, 3),
    }
    # A metric in a file of another program may have the name of a column. The second merge keeps the
    # value of the column, the first one its position.
    return columns | shorten_coverage(town.road_map.metrics or {}) | columns


def _write_splits(spec: PackSpec, towns: Sequence[_Town], folder: Path) -> dict[str, _SplitSize]:
    """Writes the list of each split and its indices.

    Returns the numbers of maps and niches of each split that has maps.
    """
    numbers: dict[str, _SplitSize] = {}
    for split in SPLITS:
        split_towns = [town for town in towns if town.split == split]
        if split_towns:
            niches = {town.niche for town in split_towns}
            numbers[split] = {"maps": len(split_towns), "niches": len(niches)}
            _write_indices(spec, split, split_towns, folder)
        # Each split has its list, also if it is empty.
        ids = "".join(f"{town.id}\n" for town in split_towns)
        write_atomic(folder / "splits" / f"{split}.txt", ids.encode())
    return numbers


def _write_indices(spec: PackSpec, split: str, towns: Sequence[_Town], folder: Path) -> None:
    """Writes the index of a split into a folder of its own, for each format that has indices."""
    for to in spec.to:
        index = FORMATS[to].catalogue
        if index is None:
            continue
        files: list[Path] = []
        for town in towns:
            files += [folder / to / town.niche / file for file in FORMATS[to].paths(town.id)]
        index_folder = folder / to / split
        for name, content in index(index_folder, files).items():
            write_atomic(index_folder / name, content)


def _node(trip: Row, end: str) -> LaneNode:
    """Returns the start or the goal of a trip."""
    return LaneNode(trip[f"{end}_row"], trip[f"{end}_column"], trip[f"{end}_heading"])


def _trips(
    spec: PackSpec, town: _Town, graph: LaneGraph, lane_offset: float = LANE_OFFSET
) -> list[Row]:
    """Draws starts and goals between the tiles.

    Each trip has the exact length of the shortest way, in tiles.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    # The trips of a map depend on its roads and the seed, not on the other maps.
    rng = np.random.default_rng([spec.seed, int(town.id, 16)])
    count = graph.nodes.row.size
    lengths_of_lanes = lane_lengths(lane_offset)[graph.movements.turn]
    ways = csr_array((lengths_of_lanes, graph.edges.T), shape=(count, count))

    # A table has a length for each node. At least one table is kept, even if it is larger than
    # the cache. The goals take at most as much memory as the lengths.
    @lru_cache(1 + _CACHED_LENGTHS // count)
    def lengths_from(start: int) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        lengths = dijkstra(ways, indices=start)
        return lengths, np.flatnonzero(np.isfinite(lengths) & (lengths > 0))

    trips: list[Row] = []
    # A trip starts at a node that a movement leaves.
    for start in rng.choice(np.unique(graph.edges[:, 0]), spec.trips).tolist():
        lengths, goals = lengths_from(start)
        goal = rng.choice(goals)
        # The columns of a trip are start_row, start_column and so on; `_node` reads them.
        trip: Row = {}
        for end, index in (("start", start), ("goal", goal)):
            for field, value in graph.node(index)._asdict().items():
                trip[f"{end}_{field}"] = value
        trip["length"] = round(float(lengths[goal]), 6)
        trips.append(trip)
    return trips


def _card(
    spec: PackSpec,
    record: PackRecord,
    rows: Sequence[Row],
    lane_offset: float,
) -> str:
    """Writes the README of a pack."""
    version = record["versions"]["elitelanes_jax"]
    lines = [
        "# A pack of road maps",
        "",
        f"{pluralize(len(rows), 'map')} of a miniature city, and {pluralize(spec.trips, 'trip')} on each. "
        f"Made by Elite Lanes JAX {version}.",
        "",
    ]
    lines += _table_of_splits(record["splits"], rows)
    lines += [
        "",
        "The numbers are the least, the median and the largest of the split. "
        "`lanes` counts ways across a tile. `trip` is a map's mean trip, in tiles. "
        "No niche is in two splits. "
        f"Maps of two splits differ in at least {100 * ALIKE:g} % of their tiles, "
        "even if they are moved, rotated or mirrored. "
        "Empty rows and columns around the roads do not count as tiles. "
        "A map's id is the same for all maps with the same roads.",
        "",
        "| file | content |",
        "|---|---|",
        "| `maps.csv` | the maps: id, niche, split and metrics |",
        "| `splits/train.txt` | the ids of a split |",
        "| `maps/NICHE/ID.json` | a map: tile codes, 8·N + 4·E + 2·S + 1·W |",
        "| `trips/NICHE/ID.csv` | starts, goals, and the exact length of the shortest way in tiles |",
    ]
    for to in spec.to:
        for file in FORMATS[to].paths("ID"):
            lines.append(f"| `{to}/NICHE/{file}` | for `{to}` |")
        if FORMATS[to].catalogue is not None:
            for split in record["splits"]:
                lines.append(f"| `{to}/{split}` | the index of a split, for `{to}` |")
    if "sumo" in spec.to:
        lines.append(f"| `sumo/NICHE/ID{_ROUTES}` | the trips for `sumo` |")
    lines += [
        f"| `{RECORD}` | settings and versions |",
        f"| `{SUMS}` | checksums: `sha256sum -c {SUMS}` |",
        "",
        "A trip starts where a tile is entered and ends where another one is: "
        "row, column, and heading, 0 north, 1 east, 2 south, 3 west. "
        "Its length is measured along the lanes' centres, "
        f"{lane_offset:g} tile right of the middle of the road. Nobody turns back.",
        "",
        f"Settings: `{json.dumps(record['settings'])}`",
        "",
    ]
    return "\n".join(lines)


def _table_of_splits(splits: Mapping[str, _SplitSize], rows: Sequence[Row]) -> list[str]:
    """Returns the lines of a table with a column for each split.

    The rows are its maps, its niches, and what was measured.
    """
    rows_of: dict[str, list[Row]] = {split: [] for split in splits}
    for row in rows:
        rows_of[row["split"]].append(row)
    lines = [
        _table_row("", splits),
        "|---|" + "---|" * len(splits),
        _table_row("maps", [len(split_rows) for split_rows in rows_of.values()]),
        _table_row("niches", [numbers["niches"] for numbers in splits.values()]),
    ]
    for feature in _SHOWN:
        spreads = []
        for split_rows in rows_of.values():
            spreads.append(_spread([row[feature] for row in split_rows]))
        lines.append(_table_row(feature, spreads))
    return lines


def _table_row(head: str, cells: Iterable[str | int]) -> str:
    """Returns a row of a table in Markdown. A head of "" leaves its cell empty."""
    texts = [f"{head} " if head else ""]
    for cell in cells:
        texts.append(f"{cell} ")
    return "| " + "| ".join(texts) + "|"


def _spread(values: Sequence[float]) -> str:
    """Returns the least value, the median and the largest value, as text."""
    low, middle, high = np.quantile(values, [0, 0.5, 1])
    return f"{low:g} .. {middle:g} .. {high:g}"


def _foreign(folder: Path) -> str | None:
    """Returns the first file in a folder that no pack lists; None without one."""
    try:
        written = {*read_sums(folder), SUMS}
    except (OSError, UnicodeDecodeError):
        return f"no {SUMS}"
    if RECORD not in written:
        return f"{RECORD} missing"
    return foreign_file(folder, written.__contains__)

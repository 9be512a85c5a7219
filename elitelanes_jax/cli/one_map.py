"""The commands on a single map: ``elitelanes show``, ``render``, ``plan`` and ``furnish``."""

import argparse
import sys
import textwrap
from pathlib import Path

from elitelanes_jax._util.cells import cell_name
from elitelanes_jax._util.checks import SEED, check_named, file_named, nonblank, one_of, path, real
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.files import check_new, never_replacing
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax._util.progress import announce
from elitelanes_jax.cli.arguments import Commands, add_command, add_shared, checked_by, naming
from elitelanes_jax.cli.program import say
from elitelanes_jax.formats.road_map import RoadMap, read_map

_SEED = checked_by(SEED)


def add_show(commands: Commands) -> None:
    command = add_command(
        commands, "show", _show, help="draw a map in the terminal, with its metrics"
    )
    add_shared(command, "map", metavar="MAP")


def _show(options: argparse.Namespace) -> int:
    from elitelanes_jax.formats.sketch import draw_text
    from elitelanes_jax.formats.table import measure_maps

    codes = read_map(options.map).codes
    (figures,) = measure_maps([str(options.map)], [codes])
    drawn = draw_text(codes, named=True)
    try:
        # Otherwise `say` would escape each character that the terminal lacks.
        drawn.encode(getattr(sys.stdout, "encoding", None) or "ascii")
    except UnicodeEncodeError:
        drawn = draw_text(codes, ascii_only=True, named=True)
    # The size comes first, and the file's name is left out, because the user has given it.
    words = [f"{figures.pop('height')} x {figures.pop('width')} tiles"]
    words += [
        f"{key.replace('_', ' ')} {round(value, 3)}"
        for key, value in figures.items()
        if key != "file"
    ]
    say(drawn + "\n\n" + "\n".join(textwrap.wrap(", ".join(words), 100)), asked=True)
    return 0


def add_render(commands: Commands) -> None:
    command = add_command(
        commands, "render", _render, help="draw a map file again: other tiles, another size"
    )
    add_shared(command, "map")
    add_shared(
        command,
        "--out",
        required=False,
        help="folder to write to, new or empty; by default map/ next to map.json",
    )
    add_shared(command, "--tiles", "--tile-px")
    command.add_argument(
        "--objects",
        type=checked_by(path),
        metavar="DIR",
        help="folder of the pictures of the map's objects; by default the package's own",
    )
    command.add_argument(
        "--seed",
        type=_SEED,
        metavar="N",
        help="draw other variants of tiles and objects; "
        "by default the map's own tiles, if the set has them",
    )
    command.add_argument(
        "--dead-ends",
        type=checked_by(one_of("grass")),
        metavar="HOW",
        help="grass: remove roads that lead nowhere; "
        "by default they are drawn with the set's tiles of kind end",
    )
    command.add_argument(
        "--overlay", action="store_true", help="also write the picture with the labels over it"
    )
    add_shared(command, "--force")


def _render(options: argparse.Namespace) -> int:
    from elitelanes_jax.maps.exporting import without_ends
    from elitelanes_jax.maps.faults import warn_of_faults
    from elitelanes_jax.maps.folder import foreign_to_picture
    from elitelanes_jax.tiles.object_set import load_objects
    from elitelanes_jax.tiles.rendering import describe_other_pictures, render, write_png
    from elitelanes_jax.tiles.tileset import load_tiles

    road_map, tiles = read_map(options.map), load_tiles(options.tiles)
    out = options.out or _picture_folder(options.map)
    objects = options.objects and load_objects(options.objects)
    # Faults are announced below. They are those of the map without its dead ends, as it is drawn.
    with naming(options.map):
        road_map = without_ends(road_map, options.dead_ends)
    warn_of_faults(str(options.map), road_map)
    # With a seed the pictures are chosen anew in any case.
    if options.seed is None and (line := describe_other_pictures(road_map, tiles)):
        announce(f"{options.map}: {line}")
    # An error of drawing does not name the map's file.
    with naming(options.map):
        picture = render(
            road_map, tiles, tile_px=options.tile_px, seed=options.seed, objects=objects
        )
    with output_folder(
        out, {"command": "render"}, foreign=foreign_to_picture, force=options.force
    ) as work:
        picture.save(work.files)
        if options.overlay:
            write_png(work.files / "overlay.png", picture.overlay())
    say(f"{picture.image.shape[1]} x {picture.image.shape[0]} pixels in {out}")
    return 0


def _picture_folder(source: Path) -> Path:
    """Returns the folder for the pictures of a map: the path of the map without its suffix."""
    # A path such as "." has no suffix to remove, and `with_suffix` raises an error.
    out = source if source.is_dir() else source.with_suffix("")
    # The pictures must not be written over the map itself.
    if out == source:
        which = "is a folder too" if source.is_dir() else "has no suffix to leave out"
        raise InputError("--out", f"a folder for the pictures of {source}, which {which}", "none")
    return out


def add_plan(commands: Commands) -> None:
    command = add_command(
        commands,
        "plan",
        _plan,
        help="a plan to build a map from: tiles, tape, signs",
        description="Writes a plan to build a map from: where each tile lies, the sides of the "
        "floor, signs and objects, and a bill of tiles and tape. A PDF also has a check-list.",
    )
    add_shared(command, "map")
    out = "a new file that ends in .pdf, .svg or .png"
    command.add_argument("--out", type=checked_by(path), required=True, metavar="FILE", help=out)
    command.add_argument(
        "--tags",
        action="store_true",
        help="write the AprilTags of the map's signs instead, to print: "
        "black squares of 6.5 cm on A4, .pdf",
    )
    command.add_argument(
        "--tile-size",
        type=checked_by(real(0.55, 2, unit="metres")),
        metavar="METRES",
        help="side of a tile; by default 0.585, as Duckietown has it",
    )


def _plan(options: argparse.Namespace) -> int:
    from elitelanes_jax.maps.faults import warn_of_faults

    if options.tags and options.tile_size is not None:
        raise InputError(
            "--tile-size", "none with --tags, which have one size", f"{options.tile_size:g}"
        )
    road_map = read_map(options.map)
    warn_of_faults(str(options.map), road_map)
    # An existing file is an error before the plan is drawn, which takes longer.
    check_new(options.out)
    write = _write_tags if options.tags else _write_plan
    try:
        with never_replacing(options.out):
            written = write(road_map, options)
    except InputError as error:
        sources = {"file": "--out", "map": options.map}
        raise error.replace(subject=sources.get(error.subject, error.subject)) from None
    say(f"{written}, in {options.out}")
    return 0


def _write_plan(road_map: RoadMap, options: argparse.Namespace) -> str:
    """Writes a plan; returns what it needs."""
    from elitelanes_jax.formats.plan import make_plan
    from elitelanes_jax.formats.plan_pages import plan_kind

    # A bad name of the file is refused before the map is read through.
    plan_kind(options.out)
    # The default side of a tile is that of `make_plan`.
    size = {} if options.tile_size is None else {"tile_size": options.tile_size}
    plan = make_plan(road_map, **size)
    plan.save(options.out)
    tape = ", ".join(f"{metres:.2f} m {colour}" for colour, metres in plan.tape.items())
    tiles = pluralize(len(plan.placed), "tile")
    say(
        f"up to {len(plan.loop) - 1} robots can never block each other; beyond that, the loop of "
        f"{len(plan.loop)} tiles from {cell_name(*plan.loop[0])} clockwise fills first"
    )
    return f"{tiles} on {plan.floor[0]:g} x {plan.floor[1]:g} m, tape {tape}"


def _write_tags(road_map: RoadMap, options: argparse.Namespace) -> str:
    """Writes the tags of a map; returns how many."""
    from elitelanes_jax.tiles.tag_pages import write_tags

    return f"{pluralize(write_tags(road_map, options.out), 'tag')} to print"


def add_furnish(commands: Commands) -> None:
    command = add_command(
        commands,
        "furnish",
        _furnish,
        help="place signs, buildings, trees, vehicles and duckies on a map",
        description="Places signs by Duckietown's rules, and other objects at random; "
        "replaces the map's objects.",
        notes="""examples:
  elitelanes furnish map.json signs --out signed.json
  elitelanes furnish map.json all trees=0.4 duckies=6 --seed 3 --out furnished.json
  elitelanes furnish map.json signs street_names own.toml --unique-tags --out named.json
""",
    )
    add_shared(command, "map")
    command.add_argument(
        "furnish",
        type=checked_by(nonblank),
        nargs="+",
        metavar="WHAT",
        help="signs, street_names, all, amounts such as duckies=6 or trees=0.2: below 1 a share of "
        "the cells without road, lights=0.5: a share of the crossings, and a file .toml, .json or "
        ".yaml with objects of your own",
    )
    command.add_argument(
        "--unique-tags",
        action="store_true",
        help="refuse to use a tag number twice; the same as the word unique_tags",
    )
    named = checked_by(file_named(".json"))
    command.add_argument(
        "--out", type=named, required=True, metavar="FILE", help="a new map file, .json"
    )
    command.add_argument(
        "--seed", type=_SEED, default=0, metavar="N", help="seed of the places; by default 0"
    )
    tiles = (
        "tile pictures in whose lanes lane_robots and lane_duckies are; "
        "by default the package's own"
    )
    command.add_argument("--tiles", type=checked_by(path), metavar="DIR", help=tiles)


def _furnish(options: argparse.Namespace) -> int:
    from elitelanes_jax.formats.objects import check_objects
    from elitelanes_jax.lanes.curves import LANE_OFFSET
    from elitelanes_jax.maps.faults import warn_of_faults
    from elitelanes_jax.maps.furnishing.placing import furnish
    from elitelanes_jax.maps.furnishing.signs import crossings, has_free_corners
    from elitelanes_jax.maps.furnishing.spec import parse_furnish

    # The words are checked before the map is read, and --unique-tags is one of them.
    spec = check_named(
        "furnish", parse_furnish, options.furnish + ["unique_tags"] * options.unique_tags
    )
    # An existing file is an error before objects are placed.
    check_new(options.out)
    road_map, lane_offset = read_map(options.map), LANE_OFFSET
    # Lanes of another tile set may be nearer to the road's middle or farther from it.
    if options.tiles is not None:
        from elitelanes_jax.tiles.tileset import load_tiles

        lane_offset = load_tiles(options.tiles).lane_offset
    # A file may place objects outside of this map.
    check_named(
        f"furnish {' '.join(options.furnish)}", check_objects, spec.objects, *road_map.codes.shape
    )
    with naming(options.map):
        furnished = furnish(road_map, spec, seed=options.seed, lane_offset=lane_offset)
    with never_replacing(options.out):
        furnished.save(options.out)
    warn_of_faults(str(options.out), furnished)
    placed = f"{pluralize(len(furnished.objects or ()), 'object')} in {options.out}"
    arms = crossings(furnished.codes)
    wanted = ["signs"] if spec.signs != "none" else []
    wanted += ["lights"] if spec.lights else []
    if wanted and not any(has_free_corners(furnished.codes, tile) for tile in arms):
        why = "each crossing has a road at a corner" if arms else "the map has no crossing"
        placed += f"; no {' or '.join(wanted)}, because {why}"
    say(placed)
    return 0

"""The command ``elitelanes render``."""

import argparse
from dataclasses import replace

from elitelanes_jax._util.checks import folder, one_of, path, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.cli.arguments import Commands, add_blend, add_force, add_map, add_tile_pictures, checked_by
from elitelanes_jax.cli.program import say


def add_render(commands: Commands) -> None:
    command = commands.add_parser("render", help="draw a map file again: other tiles, another size")
    add_map(command)
    command.add_argument(
        "--out",
        type=checked_by(folder),
        metavar="DIR",
        help="folder to write to, new or empty; by default map/ next to map.json",
    )
    add_tile_pictures(command)
    add_blend(command)
    command.add_argument(
        "--objects",
        type=checked_by(path),
        metavar="DIR",
        help="folder of the pictures of the map's objects; by default the package's own",
    )
    command.add_argument(
        "--seed",
        type=checked_by(whole(0, 2**32 - 1)),
        metavar="N",
        help="draw other variants of tiles and objects; by default the map's own tiles, if the set has them",
    )
    command.add_argument(
        "--dead-ends",
        type=checked_by(one_of("grass")),
        metavar="HOW",
        help="grass: remove roads that lead nowhere; by default they are drawn with the set's tiles of kind end",
    )
    command.add_argument("--overlay", action="store_true", help="also write the picture with the labels over it")
    add_force(command)
    command.set_defaults(action=_render)


def _render(options: argparse.Namespace) -> int:
    from elitelanes_jax._util.folders import output_folder
    from elitelanes_jax.formats.duckietown import without_dead_ends
    from elitelanes_jax.formats.road_map import read_map
    from elitelanes_jax.maps.folder import foreign_to_picture
    from elitelanes_jax.tiles.object_set import load_objects
    from elitelanes_jax.tiles.rendering import overlay, render, write_picture, write_png
    from elitelanes_jax.tiles.tileset import load_tiles

    road_map, tiles = read_map(options.map), load_tiles(options.tiles, blend=options.blend)
    objects = options.objects and load_objects(options.objects)
    if options.dead_ends:
        road_map = replace(road_map, codes=without_dead_ends(road_map.codes))
    out = options.out or options.map.with_suffix("")
    try:
        picture = render(road_map, tiles, tile_px=options.tile_px, seed=options.seed, objects=objects)
    except InputError as error:
        raise InputError(f"{options.map}: {error}") from None
    with output_folder(
        out, {"command": "render"}, foreign=foreign_to_picture(tiles.layers), force=options.force
    ) as work:
        write_picture(work.files, picture)
        if options.overlay:
            write_png(work.files / "overlay.png", overlay(picture))
    say(f"{picture.image.shape[1]} x {picture.image.shape[0]} pixels in {out}")
    return 0

"""The command ``elitelanes``."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from elitelanes_jax.command import (
    Parser,
    add_drawing,
    add_wishes,
    folder_name,
    guarded,
    leave,
    say,
    whole,
    wishes_in,
)
from elitelanes_jax.dataset_command import add_dataset
from elitelanes_jax.errors import InputError
from elitelanes_jax.exports.command import add_export, add_show
from elitelanes_jax.tiles_command import add_tiles
from elitelanes_jax.version import __version__

__all__ = ["main", "run"]

# What is slow to import (JAX, OpenCV) is imported by the commands that need it.


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    options = _parser().parse_args(arguments)
    return guarded("elitelanes", lambda: options.run(options), interrupted=options.interrupted)


def run() -> NoReturn:
    """The console script."""
    leave(main)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="elitelanes", description="Evolves road maps of a miniature city and draws them.")
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    _add_generate(commands)
    _add_render(commands)
    add_dataset(commands)
    add_export(commands)
    add_show(commands)
    add_tiles(commands)
    return parser


class _Version(argparse.Action):
    def __call__(self, *_: Any) -> NoReturn:
        print(f"elitelanes {__version__}")
        raise SystemExit(0)


def _add_generate(commands: Any) -> None:
    command = commands.add_parser(
        "generate",
        help="evolve maps and draw them",
        description="Evolves maps that are valid, different and spread over the niches; draws them with their masks.",
    )
    command.add_argument(
        "--out", type=folder_name, required=True, metavar="DIR", help="folder to write to, new or empty"
    )
    command.add_argument(
        "--size",
        type=whole(2, 1024),
        nargs=2,
        default=[12, 12],
        metavar=("ROWS", "COLUMNS"),
        help="of each map, in tiles; by default 12 12",
    )
    command.add_argument("--maps", type=whole(1), default=16, metavar="N", help="how many maps; by default 16")
    command.add_argument(
        "--seeds", type=whole(1), default=8, metavar="N", help="how many independent runs to choose from; by default 8"
    )
    command.add_argument(
        "--seed", type=whole(0, 2**32 - 1), default=0, metavar="N", help="of everything random; by default 0"
    )
    add_wishes(command, evaluations=200_000)
    command.add_argument(
        "--from",
        dest="initial",
        type=folder_name,
        nargs="+",
        default=[],
        metavar="MAP",
        help="maps that every run begins with, map.json or Duckietown's .yaml",
    )
    add_drawing(command)
    command.set_defaults(run=_generate)


def _generate(options: argparse.Namespace) -> int:
    from elitelanes_jax.compile_cache import use_compile_cache
    from elitelanes_jax.generate import Settings, generate
    from elitelanes_jax.wishes import Wishes

    use_compile_cache()
    given = {name: getattr(options, name) for name in Settings._fields if hasattr(options, name)}
    given |= {"size": tuple(options.size), "initial": tuple(options.initial), "wishes": Wishes(**wishes_in(options))}
    settings = Settings(**given)
    maps = generate(settings, options.out)
    columns = (
        "fitness",
        "cyclomatic",
        "crossings",
        "bridges",
        "adjacent_crossings",
        "adjacent_turns",
        "straight_score",
    )
    heads = ("map", *(name.replace("_", " ") for name in columns))
    lines = ["  ".join(heads)]
    for number, road_map in enumerate(maps):
        figures = {"fitness": road_map.fitness} | dict(road_map.metrics or {})
        row = [f"{number:04d}", *(str(figures[name]) for name in columns)]
        lines.append("  ".join(cell.rjust(len(head)) for cell, head in zip(row, heads, strict=True)))
    lines.append(f"{len(maps)} maps in {options.out / 'maps'}, all of them on {options.out / 'overview.png'}")
    say("\n".join(lines))
    return 0


def _add_render(commands: Any) -> None:
    command = commands.add_parser("render", help="draw a map file again: other tiles, another size")
    command.add_argument("map", type=Path, help="a map.json, any JSON file with codes, or a Duckietown map, .yaml")
    command.add_argument(
        "--out",
        type=folder_name,
        metavar="DIR",
        help="folder to write to, new or empty; by default map/ beside map.json",
    )
    add_drawing(command)
    command.add_argument(
        "--seed",
        type=whole(0, 2**32 - 1),
        metavar="N",
        help="draw other variants of the tiles; by default the map's own, if the set has them",
    )
    command.add_argument("--overlay", action="store_true", help="also the picture with the labels laid over it")
    command.set_defaults(run=_render)


def _render(options: argparse.Namespace) -> int:
    from elitelanes_jax.folders import new_folder
    from elitelanes_jax.render import overlay, recall_tiles, render, write_picture, write_png
    from elitelanes_jax.roadmap import read_map
    from elitelanes_jax.tilesets import load_tiles

    road_map, tiles = read_map(options.map), load_tiles(options.tiles)
    chosen = recall_tiles(road_map, tiles) if options.seed is None else None
    out = options.out or options.map.with_suffix("")
    try:
        picture = render(road_map.codes, tiles, tile_px=options.tile_px, seed=options.seed or 0, chosen=chosen)
    except InputError as error:
        raise InputError(f"{options.map}: {error}") from None
    with new_folder(out) as folder:
        write_picture(folder, picture)
        if options.overlay:
            write_png(folder / "overlay.png", overlay(picture))
    say(f"{picture.image.shape[1]} x {picture.image.shape[0]} pixels in {out}")
    return 0

"""The command ``elitelanes drive``."""

import argparse
from pathlib import Path

from elitelanes_jax._util.checks import SEED, one_of, real, whole
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.progress import announce
from elitelanes_jax.cli.arguments import Commands, add_command, add_shared, checked_by, file_ending
from elitelanes_jax.cli.program import say


def add_drive(commands: Commands) -> None:
    command = add_command(
        commands,
        "drive",
        _drive,
        help="drive on a map and film it",
        description="Lets a robot drive on a map: a film of its camera beside the map, or a "
        "picture of many trails.",
    )
    add_shared(command, "map")
    command.add_argument(
        "--out",
        type=file_ending(".mp4", ".gif", ".png"),
        required=True,
        metavar="FILE",
        help="new file: a film of one ride, .mp4 or .gif, or a .png with all trails",
    )
    command.add_argument(
        "--policy",
        type=checked_by(_policy),
        default="route",
        metavar="NAME|FILE.py",
        help="route: pure pursuit along a shortest way to a goal; random: wheels that turn at "
        "random; or a file of Python with a function act(observation) that returns two numbers, "
        "-1 to 1; by default route",
    )
    command.add_argument(
        "--action",
        dest="commands",
        type=checked_by(one_of("wheels", "twist")),
        default="wheels",
        metavar="NAME",
        help="what the numbers of a policy are: wheels, the commands of the left and the right "
        "wheel, or twist, the speed and the turn; by default wheels",
    )
    command.add_argument(
        "--rides",
        type=checked_by(whole(1, 1000)),
        metavar="N",
        help="trails in a picture; by default 6; a film shows one ride",
    )
    command.add_argument(
        "--seconds",
        type=checked_by(real(0, 600, unit="seconds, a number", exclusive=True)),
        default=60,
        metavar="S",
        help="longest time of a ride, which ends at its goal; from 2.3 seconds on, all goals are "
        "within reach; by default 60",
    )
    add_shared(command, "--tiles")
    add_shared(command, "--tile-px", default=128)
    command.add_argument(
        "--seed",
        type=checked_by(SEED),
        default=0,
        metavar="N",
        help="seed of the starts, the goals and the wheels; by default 0",
    )


def _policy(text: str) -> str | Path:
    # A name that ends in .py is a file, and any other name is one of the package's.
    return Path(text) if text.endswith(".py") else one_of("route", "random", "FILE.py")(text)


def _drive(options: argparse.Namespace) -> int:
    from elitelanes_jax._util.files import check_new, never_replacing, write_atomic
    from elitelanes_jax.drive.films import film, trails, write_film
    from elitelanes_jax.drive.rides import RATE, load_policy, make_rides
    from elitelanes_jax.formats.road_map import read_map
    from elitelanes_jax.maps.faults import warn_of_faults
    from elitelanes_jax.search.compile_cache import use_compile_cache
    from elitelanes_jax.tiles.rendering import (
        choose_tiles,
        describe_other_pictures,
        png_of,
        recall_choice,
    )
    from elitelanes_jax.tiles.tileset import load_tiles

    # This check comes before the rides, which take longer.
    check_new(options.out)
    kind, rides_shown = options.out.suffix.lower(), options.rides or 6
    if kind in (".mp4", ".gif"):
        if options.rides is not None:
            raise InputError("--rides", "none with a film, which shows one ride", options.rides)
        # A film needs only the ride that it shows.
        rides_shown = 1
    road_map, tiles = read_map(options.map), load_tiles(options.tiles)
    # The ride may fail because of such a fault, so the warning comes before it.
    warn_of_faults(str(options.map), road_map)
    if line := describe_other_pictures(road_map, tiles):
        announce(f"{options.map}: {line}")
    policy = options.policy
    if isinstance(policy, Path):
        policy = load_policy(policy)
    # The ride compiles programs, which later commands read from the cache.
    use_compile_cache()
    try:
        # A map that was drawn with this tile set looks as it did there.
        chosen = recall_choice(road_map, tiles)
        if chosen is None:
            chosen = choose_tiles(road_map.codes, tiles)
        rides = make_rides(
            road_map.codes,
            rides_shown,
            policy=policy,
            action=options.commands,
            seconds=options.seconds,
            seed=options.seed,
            tiles=tiles,
        )
    except InputError as error:
        # The messages name the policy or the tiles, or say what is wrong with the map without its
        # file.
        if error.subject in ("policy", "tiles"):
            raise error.replace(subject=f"--{error.subject}") from None
        raise error.within(options.map) from None
    # Films and trails look alike: the same tiles at the same size.
    look = {"tile_px": options.tile_px, "chosen": chosen}
    with never_replacing(options.out):
        if kind == ".png":
            write_atomic(options.out, png_of(trails(road_map, tiles, rides, **look)))
        else:
            write_film(options.out, film(road_map, tiles, rides, **look))
    reached, count = int(rides.success.sum()), len(rides.success)
    driven = f"{rides.steps.sum() / RATE:.1f} s driven"
    left = int(rides.off_road.sum())
    off_road = f"{pluralize(left, 'ride')} left the road, " if left else ""
    say(f"{reached} of {count} goals reached, {off_road}{driven}, in {options.out}")
    return 0

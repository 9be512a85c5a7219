"""The command ``elitelanes explore``."""

import argparse
from pathlib import Path

from elitelanes_jax._util.checks import path
from elitelanes_jax.cli.arguments import Commands, add_command, add_shared, checked_by, file_ending
from elitelanes_jax.cli.program import say

_PAGE = "explore.html"


def add_explore(commands: Commands) -> None:
    command = add_command(
        commands,
        "explore",
        _explore,
        help="show runs and maps in a browser, and draw maps",
        description="Writes one page, without a server, that shows all niches of runs, opens, "
        "filters and compares maps, and edits maps.",
        notes="""examples:
  elitelanes explore maps --open
  elitelanes explore maps more-maps --out both.html
  elitelanes explore docs/examples/town.json --out town.html
""",
    )
    command.add_argument(
        "sources",
        type=checked_by(path),
        nargs="+",
        metavar="RUN_DIR|MAP",
        help="a folder of generate or pick, or a folder of such folders; an archive.npz; a "
        "map.json or a map of Duckietown, .yaml or a folder of layers",
    )
    command.add_argument(
        "--out",
        type=file_ending(".html", ".htm"),
        metavar="FILE",
        help=f"new file; by default {_PAGE} in the folder that is given, "
        "or here for several sources and for maps",
    )
    command.add_argument("--open", action="store_true", help="open the page in the browser")
    add_shared(
        command,
        "--tiles",
        help="tile pictures; by default those of the first run whose pictures are found, "
        "or the package's own",
    )
    add_shared(command, "--tile-px")
    add_shared(command, "--force", help="replace an earlier page")


def _is_run(source: Path) -> bool:
    # A folder of layers is a single map of Duckietown.
    from elitelanes_jax.formats.dt_layers import is_layers

    return source.is_dir() and not is_layers(source)


def _explore(options: argparse.Namespace) -> int:
    from elitelanes_jax.explorer.page import explore

    first = options.sources[0]
    # The page of one run is in the run's folder, where it is found again.
    out = options.out or (
        first / _PAGE if len(options.sources) == 1 and _is_run(first) else Path(_PAGE)
    )
    size = explore(
        options.sources,
        out,
        tiles=options.tiles,
        tile_px=options.tile_px,
        force=options.force,
    )
    say(f"{size / 2**20:.1f} MiB in {out}")
    if options.open:
        import webbrowser

        # Hosts without a screen have no browser. The page is written nevertheless.
        if not webbrowser.open(out.resolve().as_uri()):
            say("no browser was found; open the page in one")
    return 0

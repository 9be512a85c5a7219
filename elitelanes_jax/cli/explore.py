"""The command ``elitelanes explore``."""

import argparse
from pathlib import Path

from elitelanes_jax._util.checks import name, path
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.cli.arguments import Commands, add_blend, add_tile_pictures, checked_by
from elitelanes_jax.cli.program import say

_PAGE = "explore.html"

_EXAMPLES = """examples:
  elitelanes explore maps --open
  elitelanes explore maps more-maps --out both.html
  elitelanes explore docs/examples/town.json --out town.html
"""


def add_explore(commands: Commands) -> None:
    """Adds the command to a parser's."""
    command = commands.add_parser(
        "explore",
        help="look through runs and maps, and draw maps, in a browser",
        description="Writes one page, without a server, to look through all niches of runs, to open, filter and "
        "compare their maps, and to draw others.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument(
        "sources",
        type=checked_by(path),
        nargs="+",
        metavar="RUN_DIR|MAP",
        help="a folder of generate or pick, or one of such folders; an archive.npz; a map.json or a Duckietown .yaml; "
        "rides of drive, .json",
    )
    command.add_argument(
        "--out",
        type=checked_by(path),
        metavar="FILE",
        help=f"new file; by default {_PAGE} in the folder of the run, or here for several runs and for maps",
    )
    command.add_argument(
        "--title", type=checked_by(name), metavar="TEXT", help="of the page; by default the run's name"
    )
    command.add_argument("--open", action="store_true", help="open the page in the browser")
    add_tile_pictures(command, usual="those of the first run if they are found, else the package's own")
    add_blend(command)
    command.add_argument("--force", action="store_true", help="replace a page that was written before")
    command.set_defaults(action=_explore)


def _explore(options: argparse.Namespace) -> int:
    from elitelanes_jax.explorer.page import explore

    out = options.out or _default_place(options.sources)
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--out: expected a name that ends in .html, got {out}")
    size = explore(
        options.sources,
        out,
        tiles=options.tiles,
        blend=options.blend,
        tile_px=options.tile_px,
        title=options.title,
        force=options.force,
    )
    say(f"{size / 2**20:.1f} MiB in {out}")
    if options.open:
        _open(out)
    return 0


def _default_place(sources: list[Path]) -> Path:
    return sources[0] / _PAGE if len(sources) == 1 and sources[0].is_dir() else Path(_PAGE)


def _open(page: Path) -> None:
    import webbrowser

    if not webbrowser.open(page.resolve().as_uri()):
        say("no browser was found; open the page in one")

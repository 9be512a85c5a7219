"""The command ``elitelanes``.

Commands import what they need when they run, because JAX and OpenCV load slowly.
"""

import argparse
import sys
from collections.abc import Sequence
from typing import NoReturn

from elitelanes_jax._util.folders import check_apart, has_unfinished
from elitelanes_jax._util.packages import __version__
from elitelanes_jax._util.records import inputs_among
from elitelanes_jax._util.types import Untyped
from elitelanes_jax.cli.arguments import Parser
from elitelanes_jax.cli.dataset import add_dataset
from elitelanes_jax.cli.drive import add_drive
from elitelanes_jax.cli.explore import add_explore
from elitelanes_jax.cli.export import add_export, add_pack
from elitelanes_jax.cli.generate import add_generate, add_merge, add_pick
from elitelanes_jax.cli.metrics import add_metrics
from elitelanes_jax.cli.one_map import add_furnish, add_plan, add_render, add_show
from elitelanes_jax.cli.program import INTERRUPTED, fail, guarded, say
from elitelanes_jax.cli.score import add_score
from elitelanes_jax.cli.tiles import add_tiles

_RESUMES = "what is complete is kept, and the same command resumes"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    if arguments is None:
        arguments = sys.argv[1:]
    options = make_parser(*arguments[:1]).parse_args(arguments)
    return guarded("elitelanes", lambda: _act(options), "nothing was written", options.quiet)


def _act(options: argparse.Namespace) -> int:
    """Runs a command, unless it would replace a folder that contains one of its inputs.

    If an interrupted or failed command can be resumed, the message says so.
    """
    # Not every command has these options.
    replaces = getattr(options, "force", False) or getattr(options, "force_archive", False)
    if replaces and options.out is not None:
        # Specifications check the inputs that they read. This check is for the files that a command
        # reads itself, such as a map, and comes before any work. The output folder is no input.
        values = dict(vars(options))
        del values["out"]
        check_apart(options.out, inputs_among(values))
    try:
        return int(options.action(options))
    except (KeyboardInterrupt, OSError) as error:
        # Commands without --out have nothing to resume.
        out = getattr(options, "out", None)
        if out is None or not has_unfinished(out):
            raise
        # The message says that the work can be resumed, so that nobody starts it anew.
        if isinstance(error, KeyboardInterrupt):
            return fail("elitelanes", f"interrupted; {_RESUMES}", INTERRUPTED)
        file = error.filename or out
        return fail("elitelanes", f"{file}: {error.strerror or error}; {_RESUMES}", 2)


def make_parser(command: str | None = None) -> argparse.ArgumentParser:
    """Makes the parser of one command, or of all; a parsed command has its function in ``action``.

    The options of all commands take 0.1 s, a fifth of the time that JAX takes to load.
    """
    parser = Parser(
        prog="elitelanes", description="Evolves road maps of a miniature city and draws them."
    )
    # Not every command has the option --quiet, and `guarded` reads it for all.
    parser.set_defaults(quiet=False)
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    # The order of the commands is that of the help: from making maps to using them.
    adders = (
        add_generate,
        add_merge,
        add_pick,
        add_furnish,
        add_render,
        add_dataset,
        add_drive,
        add_export,
        add_pack,
        add_show,
        add_plan,
        add_explore,
        add_metrics,
        add_tiles,
        add_score,
    )
    # The error for an unknown command, and the help, list all commands.
    of_command = [add for add in adders if add.__name__ == f"add_{command}"]
    for add in of_command or adders:
        add(commands)
    return parser


class _Version(argparse.Action):
    def __call__(self, *_: Untyped) -> NoReturn:
        say(f"elitelanes {__version__}")
        raise SystemExit(0)

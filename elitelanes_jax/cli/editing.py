"""The command ``elitelanes tiles edit``."""

import argparse
from typing import TYPE_CHECKING

from elitelanes_jax._util.checks import FLOOR_SIDE, folder, path, whole
from elitelanes_jax._util.errors import InputError, reason
from elitelanes_jax.cli.arguments import Commands, add_command, checked_by
from elitelanes_jax.cli.photographs import for_each
from elitelanes_jax.cli.program import INTERRUPTED, fail, say

if TYPE_CHECKING:
    from elitelanes_jax.explorer.serving import HandServer


def add_edit(commands: Commands) -> None:
    command = add_command(
        commands,
        "edit",
        _edit,
        help="correct corners, kinds and masks on a page in the browser",
        description="Serves a page to this computer alone, on which a tile set is corrected by "
        "hand: the corners of tiles in photographs, their kinds and directions, and masks. Save on "
        "the page writes the set; the earlier one is kept next to it. Finish on the page, or "
        "Ctrl-C, ends the command.",
        notes="""examples:
  elitelanes tiles edit my-tiles --open
  elitelanes tiles edit my-tiles --photos floor.jpg --size 3 4 --open
""",
    )
    command.add_argument(
        "folder", type=checked_by(folder), metavar="DIR", help="folder of a tile set, or a new one"
    )
    command.add_argument(
        "--photos",
        type=checked_by(path),
        nargs="+",
        default=[],
        metavar="PHOTO",
        help="JPEG or PNG files to cut more tiles from",
    )
    command.add_argument(
        "--size",
        type=checked_by(FLOOR_SIDE),
        nargs=2,
        action="append",
        metavar=("ROWS", "COLUMNS"),
        help="tiles of the floor; by default 1 1. Repeat it for each photograph if the floors differ",
    )
    command.add_argument(
        "--port", type=checked_by(whole(1, 65535)), metavar="N", help="by default any free one"
    )
    command.add_argument("--open", action="store_true", help="open the page in the browser")


def _edit(options: argparse.Namespace) -> int:
    from elitelanes_jax.explorer.serving import HandServer
    from elitelanes_jax.photographs.editing import HandWork
    from elitelanes_jax.photographs.reading import Photograph

    if options.size and not options.photos:
        raise InputError("--size", "it with --photos, whose floors it describes", "it alone")
    sizes = for_each("--size", options.size or [(1, 1)], options.photos)
    shapes = [(rows, columns) for rows, columns in sizes]
    # Photographs are read before the server starts, so that a bad file is an error in the terminal.
    photographs = [Photograph.read(file) for file in options.photos]
    work = HandWork(options.folder, photographs, shapes)
    # Port 0 means any free port.
    port = options.port or 0
    try:
        server = HandServer(work, port)
    except OSError as error:
        # Another program may listen on the port.
        raise InputError("--port", "a free port", f"{options.port}: {reason(error)}") from None
    try:
        with server:
            _serve(server, options)
    except KeyboardInterrupt:
        # A request that is in progress must not save after the message below.
        work.stop_saving()
        result = f"{options.folder} is as it was saved last" if work.saved else "nothing was saved"
        return fail("elitelanes", f"interrupted; {result}", INTERRUPTED)
    # The user has finished on the page.
    if work.saved:
        say(f"saved in {options.folder}; now: elitelanes tiles check {options.folder}")
    else:
        say("nothing was saved")
    return 0


def _serve(server: "HandServer", options: argparse.Namespace) -> None:
    """Serves the page until it is finished with."""
    # Without the address nobody can open the page, so a failure to print it is an error.
    say(f"correct {options.folder} at {server.url}\nCtrl-C ends this", asked=True)
    if options.open:
        import webbrowser

        if not webbrowser.open(server.url):
            say("no browser was found; open the page in one")
    server.serve_forever()

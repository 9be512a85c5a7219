"""The explorer as one HTML file, without a server and without requests."""

import base64
import json
from contextlib import nullcontext
from hashlib import sha256
from html import escape
from importlib.resources import files
from pathlib import Path

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, file_named
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import check_new, never_replacing, write_atomic
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.explorer._collect import collect
from elitelanes_jax.explorer._payload import Payload

_MARK = "<!doctype html>\n<!-- A page of elitelanes explore. -->\n"


@name_wrong_arguments
def explore(
    what: UserValue,
    out: str | Path,
    *,
    tiles: str | Path | None = None,
    tile_px: int = 64,
    force: bool = False,
) -> int:
    """Writes the page of a result, of maps, or of files of runs and maps, whole or not at all.

    Args:
      what: a `Result`; a map or several, as `as_maps` takes them; a mapping from names to these, to
        show several side by side; or a path or several. A path is the folder of a run of `generate`
        or `pick`, a folder of such folders, an archive, or a file of maps.
      out: the file, new.
      tiles: folder of the tile pictures; by default that of the first run whose tiles are found. If
        there is none, the package's own is used, with a line on standard error. A relative path in
        a run's record is searched from here, then from each folder above the run.
      tile_px: side of a tile's picture in pixels, 16 to 512.
      force: whether an earlier page is replaced.

    Returns:
      The number of bytes written.

    Raises:
      InputError: for anything else; for a file or folder that is missing, damaged, incomplete or of
        another kind, and for a bad tile set; for a page that exists, unless `force` is given, or
        another file; or for the suffix of another format.
      OSError: if it cannot be written.
    """
    out = Path(check_named("out", file_named(".html", ".htm"), out))
    # A file that may not be replaced is an error before the page is made.
    _check_out(out, force)
    content = page_of(collect(what, tiles=tiles, tile_px=tile_px)).encode()
    # Without `force`, a file that another process has written in the meantime is not replaced.
    with nullcontext() if force else never_replacing(out):
        write_atomic(out, content)
    return len(content)


@name_wrong_arguments
def page_of(payload: Payload) -> str:
    """Returns the text of the page. Its policy forbids the browser all requests."""
    # The page has all it needs in itself. Only this script may run, so that no name in the data
    # becomes a program, and no request can leave the page.
    script, style = static_text("explorer.js"), static_text("explorer.css")
    # The policy names the script by its digest.
    allowed = base64.b64encode(sha256(script.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; script-src 'sha256-{allowed}'; "
        "style-src 'unsafe-inline'; img-src data: blob:"
    )
    # A name that is not UTF-8.
    title = str(payload.values["title"] or "maps").encode(errors="replace").decode()
    # The values and the arrays are in scripts of types that browsers do not run.
    return (
        f'{_MARK}<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)} · Elite Lanes</title>\n<style>{style}</style>\n</head>\n"
        '<body>\n<main id="elitelanes-explorer"></main>\n'
        "<noscript>This page needs JavaScript, which is switched off.</noscript>\n"
        f'<script type="application/json" id="elitelanes-values">{_json(payload.values)}</script>\n'
        '<script type="text/plain" id="elitelanes-blob">'
        f"{base64.b64encode(payload.blob).decode()}</script>\n"
        f'<script type="module">{script}</script>\n</body>\n</html>\n'
    )


def static_text(name: str) -> str:
    """Returns a built file of the explorer: explorer.js or explorer.css."""
    return files(__package__).joinpath("static", name).read_text(encoding="utf-8")


def _json(values: object) -> str:
    """Returns JSON that is safe inside a page: no name is read as HTML."""
    # A browser could not parse NaN or infinity as JSON.
    text = json.dumps(values, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _check_out(out: Path, force: bool) -> None:
    if not out.exists():
        # A link may lead nowhere.
        check_new(out)
        return
    if out.is_dir():
        raise InputError(out, "a file for the page", "a folder")
    with out.open("rb") as stream:
        # The mark tells an earlier page from any other file of the user.
        ours = stream.read(len(_MARK)) == _MARK.encode()
    # Another file of the user is never replaced, even with `force`.
    if not ours or not force:
        hint = "force=True replaces it" if ours else ""
        if force:
            hint = "force=True replaces only pages of explore"
        raise InputError(out, "a new file", "an existing one", hint)

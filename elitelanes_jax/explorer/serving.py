"""Serves the page on which a tile set is corrected by hand, on this computer alone.

Other programs of the computer and other web sites cannot use it: each path begins with a random
token, and the headers `Host` and `Origin` must name this server. A site whose name is bound to
127.0.0.1 has another `Host`.
"""

import json
import secrets
import sys
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock

from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.files import MIB
from elitelanes_jax._util.types import Plain, Untyped
from elitelanes_jax.explorer.page import static_text
from elitelanes_jax.photographs.editing import HandWork

# The largest request: the masks of 30 tiles of 4096 x 4096 pixels.
_MOST_BYTES = 256 * MIB
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; "
    "form-action 'none'"
)
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Tiles by hand · Elite Lanes</title>
<link rel="icon" href="data:,">
<link rel="stylesheet" href="explorer.css">
<link rel="stylesheet" href="hands.css">
</head>
<body>
<main id="elitelanes-hands"></main>
<noscript>This page needs JavaScript, which is switched off.</noscript>
<script type="module" src="hands.js"></script>
</body>
</html>
"""
_STATIC = {"explorer.css": "text/css", "hands.css": "text/css", "hands.js": "text/javascript"}


class HandServer(ThreadingHTTPServer):
    """The server of one `HandWork`. `serve_forever` returns when the page is finished with.

    Attributes:
      url: the address of the page.
    """

    daemon_threads = True

    def __init__(self, work: HandWork, port: int = 0) -> None:
        """Listens on 127.0.0.1; raises `OSError` if the port is taken.

        Port 0 means any free port.
        """
        super().__init__(("127.0.0.1", port), _Handler)
        # 24 random bytes cannot be guessed.
        self.token = secrets.token_urlsafe(24)
        # The server knows its port only after it listens.
        self.hosts = [f"{name}:{self.server_address[1]}" for name in ("127.0.0.1", "localhost")]
        self.url = f"http://{self.hosts[0]}/{self.token}/"
        self.work = work
        # One request at a time computes or saves.
        self.lock = Lock()
        # The names of the actions are the paths to which the page posts.
        self.actions: dict[str, Callable[[Untyped], Plain | bytes]] = {
            "fit": work.fit,
            "cut": work.cut,
            "mask": work.mask,
            "save": work.save,
            "zip": work.zip,
            "finish": lambda _: None,
        }

    def handle_error(self, request: Untyped, client_address: Untyped) -> None:
        """Prints the traceback of a failed answer.

        Nothing is printed if the browser closed the connection, as it does on a reload.
        """
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Answers the requests of a page."""

    server: HandServer

    def do_GET(self) -> None:
        path = self._allowed_path()
        if path is None:
            return
        # The path of a photograph or a picture has its number or its name after the slash.
        name, _, item = path.partition("/")
        work = self.server.work
        try:
            if path == "":
                self._send(200, "text/html; charset=utf-8", _PAGE.encode())
            elif path in _STATIC:
                self._send(200, f"{_STATIC[path]}; charset=utf-8", static_text(path).encode())
            elif path == "state":
                self._send_json(200, work.state())
            elif name == "photographs":
                self._send(200, "image/jpeg", work.photograph(int(item)))
            elif name == "pictures":
                self._send(200, "image/png", work.picture(item))
            else:
                self._send_json(404, {"error": "no such page"})
        except (LookupError, ValueError):
            # A number or a name that does not exist is a missing page.
            self._send_json(404, {"error": "no such page"})

    def do_POST(self) -> None:
        path = self._allowed_path()
        if path is None:
            return
        action = self.server.actions.get(path)
        # A form on another web site cannot send this type of content without the browser's question
        # to this server.
        if action is None or self.headers.get_content_type() != "application/json":
            self._send_json(404, {"error": "no such action"})
            return
        # The length is checked before anything is read.
        length = self._allowed_length()
        if length is None:
            return
        try:
            values = json.loads(self.rfile.read(length))
            # Each request has a thread of its own.
            with self.server.lock:
                answer = action(values)
            if isinstance(answer, bytes):
                self._send(200, "application/zip", answer)
            else:
                self._send_json(200, answer)
            if path == "finish":
                # It follows the answer, because the process ends after it.
                self.server.shutdown()
        except InputError as error:
            # The page shows these errors next to the work that they are about.
            self._send_json(422, {"error": str(error)})
        except OSError as error:
            # The set cannot be written, for example because the disk is full.
            message = f"{error.filename}: {error.strerror}" if error.filename else str(error)
            self._send_json(422, {"error": message})
        except (LookupError, TypeError, ValueError, RecursionError) as error:
            # Only a program that is not the page sends values of another form.
            message = f"expected a request of this page, got {quote(error)}"
            self._send_json(400, {"error": message})

    def log_message(self, *_: Untyped) -> None:
        """Prints nothing: the terminal shows what was saved."""

    def _allowed_path(self) -> str | None:
        """Returns the path after the token, without slashes at its end.

        If the request is not of this server's page, the answer is an error, and the result None.
        """
        host = self.headers.get("Host", "")
        origin = self.headers.get("Origin")
        # Requests without `Origin`, such as for a picture of the page itself, have only `Host` to
        # check.
        is_from_page = host in self.server.hosts and origin in (None, f"http://{host}")
        # The path of a request is /TOKEN/PATH, and may have a query.
        path_with_token = self.path.partition("?")[0].lstrip("/")
        token, _, path = path_with_token.partition("/")
        # The time of this comparison does not tell how much of a guessed token is right.
        if is_from_page and secrets.compare_digest(token.encode(), self.server.token.encode()):
            return path.rstrip("/")
        self._send_json(403, {"error": "open the address that the command has printed"})
        return None

    def _allowed_length(self) -> int | None:
        """Returns the number of bytes of the request.

        If it is missing or too large, the answer is an error, and the result None.
        """
        length = self.headers.get("Content-Length", "")
        # Python converts no number of very many digits.
        if length.isdecimal() and len(length) <= 20 and int(length) <= _MOST_BYTES:
            return int(length)
        message = f"expected a request of at most {_MOST_BYTES // MIB} MiB"
        self._send_json(413, {"error": message})
        return None

    def _send_json(self, status: int, values: Plain) -> None:
        self._send(status, "application/json", json.dumps(values, allow_nan=False).encode())

    def _send(self, status: int, kind: str, content: bytes) -> None:
        # The page takes nothing from other sources and is in no frame of another page. The browser
        # does not guess types of content, tells no other site the address, whose token is secret,
        # and keeps no answer.
        headers = {
            "Content-Type": kind,
            "Content-Length": str(len(content)),
            "Content-Security-Policy": _POLICY,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-store",
        }
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

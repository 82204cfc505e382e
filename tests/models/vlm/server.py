"""A server on this machine that answers as it is told to, well or badly."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple

Behaviour = Callable[[BaseHTTPRequestHandler], None]


class Seen(NamedTuple):
    """A request as the server got it."""

    path: str
    headers: Mapping[str, str]
    body: Any


class Server:
    """Answers each request by the next of ``behaviours``, the last of them for ever."""

    def __init__(self) -> None:
        self.behaviours: list[Behaviour] = []
        self.seen: list[Seen] = []
        self.url = ""

    def handle(self, handler: BaseHTTPRequestHandler) -> None:
        body = handler.rfile.read(int(handler.headers["content-length"]))
        headers = {name.lower(): value for name, value in handler.headers.items()}
        self.seen.append(Seen(handler.path, headers, json.loads(body)))
        behaviour = self.behaviours[min(len(self.seen), len(self.behaviours)) - 1]
        handler.close_connection = True
        with contextlib.suppress(OSError):  # whoever asked does not listen any more
            behaviour(handler)


@contextlib.contextmanager
def running() -> Iterator[Server]:
    """Yield a server that listens at its ``url``."""
    server = Server()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            server.handle(self)

        def log_message(self, *args: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as listening:
        listening.daemon_threads = True
        listening.block_on_close = False
        server.url = f"http://127.0.0.1:{listening.server_port}"
        threading.Thread(target=lambda: listening.serve_forever(0.01), daemon=True).start()
        yield server
        listening.shutdown()


def sends(body: Any, status: int = 200, share: float = 1.0, **headers: str) -> Behaviour:
    """Send ``body``, as JSON unless it is a text, or a share of it and hang up.

    ``_`` in names of headers stands for ``-``.
    """
    content = (body if isinstance(body, str) else json.dumps(body)).encode()
    headers = {"content_type": "application/json", **headers}

    def behave(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(status)
        handler.send_header("content-length", str(len(content)))
        for name, value in headers.items():
            handler.send_header(name.replace("_", "-"), value)
        handler.end_headers()
        handler.wfile.write(content[: int(share * len(content))])

    return behave


def says_nothing(handler: BaseHTTPRequestHandler) -> None:
    """Take the request and wait."""
    time.sleep(2.0)

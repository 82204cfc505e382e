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


def sends(
    body: Any, status: int = 200, content_type: str = "application/json", **headers: str
) -> Behaviour:
    """Send ``body``, as JSON unless it is a text; ``_`` in names of headers stands for ``-``."""
    content = (body if isinstance(body, str) else json.dumps(body)).encode()
    return sends_bytes(content, status, content_type, **headers)


def sends_bytes(
    content: bytes, status: int = 200, content_type: str = "application/json", **headers: str
) -> Behaviour:
    """Send ``content`` as it is."""

    def behave(handler: BaseHTTPRequestHandler) -> None:
        _head(handler, status, len(content), content_type, headers)
        handler.wfile.write(content)

    return behave


def sends_without_end() -> Behaviour:
    """Send spaces as fast as they are taken, until nobody takes them."""

    def behave(handler: BaseHTTPRequestHandler) -> None:
        _head(handler, 200, 2**50, "application/json", {})
        while True:
            handler.wfile.write(b" " * 2**16)

    return behave


def breaks_off(body: Any) -> Behaviour:
    """Send half of what was promised and hang up."""
    content = json.dumps(body).encode()

    def behave(handler: BaseHTTPRequestHandler) -> None:
        _head(handler, 200, len(content), "application/json", {})
        handler.wfile.write(content[: len(content) // 2])

    return behave


def drips(seconds: float) -> Behaviour:
    """Send a space now and then, so that no single wait is long."""

    def behave(handler: BaseHTTPRequestHandler) -> None:
        _head(handler, 200, 10_000, "application/json", {})
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            handler.wfile.write(b" ")
            handler.wfile.flush()
            time.sleep(0.02)

    return behave


def says_nothing(seconds: float) -> Behaviour:
    """Take the request and wait."""
    return lambda handler: time.sleep(seconds)


def hangs_up(handler: BaseHTTPRequestHandler) -> None:
    """Close the connection without a word."""


def _head(
    handler: BaseHTTPRequestHandler,
    status: int,
    length: int,
    content_type: str,
    headers: Mapping[str, str],
) -> None:
    handler.send_response(status)
    handler.send_header("content-type", content_type)
    handler.send_header("content-length", str(length))
    for name, value in headers.items():
        handler.send_header(name.replace("_", "-"), value)
    handler.end_headers()

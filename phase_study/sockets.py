"""The socket between a player's browser and a seat: keys come in, messages go out."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable
from typing import Any, Final

from starlette.websockets import WebSocket, WebSocketDisconnect

from phase_study.room import KEYS, Message, Outbox, Seat
from phase_study.server import MOST_MESSAGE

# codes that close a socket; applications use those above 4000
UNFIT, TOO_MANY, ELSEWHERE, TOO_LARGE = 4400, 4429, 4409, 1009
_PING: Final = 2.0  # seconds


async def talk(
    socket: WebSocket,
    seat: Seat,
    allow: Callable[[], bool],
    heed: Callable[[Message], bool] = lambda message: False,
) -> None:
    """Connect an accepted socket to a seat until it closes; an earlier one is closed.

    Args:
        socket: of a browser.
        seat: whose stage the browser is shown at once.
        allow: whether one more message is allowed now.
        heed: called with messages other than keys; returns whether it knows them.
    """
    seat.tell({"t": "elsewhere"})
    seat.outbox = outbox = Outbox()
    seat.controls.release()
    for message in seat.stage():
        seat.tell(message)
    helpers = [
        asyncio.create_task(_pump(socket, outbox)),
        asyncio.create_task(_pinging(seat, outbox)),
    ]
    try:
        while True:
            code = _refusal(seat, await socket.receive(), allow, heed)
            if code is not None:
                await socket.close(code)
                break
    except (WebSocketDisconnect, RuntimeError):
        pass  # gone; or closed by the pump
    finally:
        for helper in helpers:
            helper.cancel()
        if seat.outbox is outbox:
            seat.outbox = None
            seat.gone_since = asyncio.get_running_loop().time()
            seat.controls.release()


def _refusal(
    seat: Seat, received: Any, allow: Callable[[], bool], heed: Callable[[Message], bool]
) -> int | None:
    """Act on a browser's message; return a code to close with if the message is not allowed."""
    if received["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(received.get("code") or 1000)
    text = received.get("text")
    if not allow():
        return TOO_MANY
    if text is None:
        return UNFIT
    if len(text.encode(errors="replace")) > MOST_MESSAGE:
        return TOO_LARGE
    try:
        given = json.loads(text)
    except (ValueError, RecursionError):
        return UNFIT
    match given:
        case {"t": "key", "key": str(key), "down": bool(down)} if key in KEYS:
            seat.controls.press(key, down)
        case {"t": "release"}:
            seat.controls.release()
        case {"t": "ready"}:
            seat.is_ready = True
        case {"t": "pong"}:
            if seat.pinged is not None:
                rtt = asyncio.get_running_loop().time() - seat.pinged
                seat.round_trips.append(1000 * rtt)
                seat.pinged = None
        case dict() if heed(given):
            pass
        case _:
            return UNFIT
    return None


async def _pump(socket: WebSocket, outbox: Outbox) -> None:
    while True:
        message = await outbox.get()
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await socket.send_text(json.dumps(message, separators=(",", ":")))
            if message["t"] == "elsewhere":
                await socket.close(ELSEWHERE)


async def _pinging(seat: Seat, outbox: Outbox) -> None:
    while True:
        await asyncio.sleep(_PING)
        seat.pinged = asyncio.get_running_loop().time()
        outbox.put({"t": "ping"})

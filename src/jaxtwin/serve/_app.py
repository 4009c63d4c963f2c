"""The web application: the page and its files, the stream, the history, commands, metrics."""

import asyncio
import hashlib
import html
import json
import mimetypes
import re
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from importlib.resources import files
from typing import Any, final

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import Receive, Scope, Send

from ..errors import JaxtwinError
from ._access import BODY_SECONDS, MAX_BODY, Access, Refusal
from ._desk import Desk
from ._frame_ring import FrameRing
from ._metrics import CONTENT_TYPE, metrics_text
from ._orders import KINDS, check_names, fields_of, order_of
from ._page import Page

# The time between two looks of a client at the ring, s: all frames between are sent together.
POLL_SECONDS = 0.05

# The time after which a line without meaning is sent, s, so that proxies keep the connection.
KEEPALIVE_SECONDS = 5.0


async def stream(
    ring: FrameRing,
    last_id: str,
    wait: Callable[[float], Awaitable[object]],
    is_closing: Callable[[], bool],
) -> AsyncIterator[bytes]:
    """Yields the frames of a ring.

    A client that begins, or whose next frame has been overwritten, gets `hello` with the number of
    lost frames, and the newest frame of each kind. One that comes back with the id of its last
    frame goes on behind it.

    **Arguments:**

    - `ring`: the ring.
    - `last_id`: the id of the last frame that the client has; `""` if it has none.
    - `wait`: waits for a number of seconds.
    - `is_closing`: whether the server ends.
    """
    yield b"retry: 1000\n\n"
    cursor = ring.cursor_of(last_id)
    lost, quiet = 0, 0.0
    while not is_closing():
        if cursor is None:
            batch = ring.newest()
            yield _hello(ring, batch.cursor, lost) + b"".join(batch.frames)
        else:
            batch = ring.after(cursor)
            if batch.lost:
                lost, cursor = batch.lost, None
                continue
            if batch.frames:
                yield b"".join(batch.frames)
            elif quiet >= KEEPALIVE_SECONDS:
                yield b":\n\n"
        quiet = 0.0 if batch.frames or quiet >= KEEPALIVE_SECONDS else quiet + POLL_SECONDS
        cursor = batch.cursor
        await wait(POLL_SECONDS)


def _hello(ring: FrameRing, cursor: int, lost: int) -> bytes:
    content = json.dumps({"server": ring.name, "lost": lost})
    return f"id: {ring.name}-{cursor}\nevent: hello\ndata: {content}\n\n".encode()


# The largest number of streams at a time.
MAX_STREAMS = 200

# The longest time until an order is obeyed or a stop is reported by the device, s.
ANSWER_SECONDS = 10.0

# The longest history, s.
MAX_SPAN = 8 * 86_400.0

# The time without a turn of the loop after which the server is not healthy, s.
STUCK_SECONDS = 10.0

HEADERS = {
    # Everything comes from this server, and nothing may be embedded.
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}

Wait = Callable[[float], Awaitable[object]]


def web_app(page: Page, desk: Desk, access: Access, wait: Wait = asyncio.sleep) -> Starlette:
    """Makes the ASGI application of a page.

    **Arguments:**

    - `page`: the page.
    - `desk`: where commands are left.
    - `access`: who may ask for what.
    - `wait`: waits for a number of seconds; tests pass their own.
    """
    web = _PageApp(page, desk, access, wait)
    routes = [
        Route("/", web.index, methods=["GET"]),
        Route("/assets/{name:path}", web.asset, methods=["GET"]),
        Route("/events", web.events, methods=["GET"]),
        Route("/history", web.history, methods=["GET"]),
        Route("/metrics", web.metrics, methods=["GET"]),
        Route("/healthz", web.health, methods=["GET"]),
        Route("/control/stop", web.stop, methods=["POST"]),
        Route("/control/{kind}", web.order, methods=["POST"]),
    ]
    app = Starlette(routes=routes)
    app.state.close = web.close
    return app


@final
class _PageApp:
    """The answers to requests."""

    def __init__(self, page: Page, desk: Desk, access: Access, wait: Wait):
        self._page, self._desk, self._access, self._wait = page, desk, access, wait
        self._assets = dict(asset_files())
        self._streams = 0
        self._closing = False

    def close(self) -> None:
        """Ends all streams."""
        self._closing = True

    async def index(self, request: Request) -> Response:
        if refusal := self._access.refuse_read(request.headers):
            return refused(refusal)
        text = self._assets["index.html"][0].decode()
        content = text.replace("<!-- values -->", self._table()).encode()
        return Response(content, 200, {**HEADERS, "cache-control": "no-store"}, "text/html")

    async def asset(self, request: Request) -> Response:
        if refusal := self._access.refuse_read(request.headers):
            return refused(refusal)
        name = request.path_params["name"]
        if name not in self._assets or name == "index.html":
            return refused(Refusal(404, "there is no such file"))
        content, kind, tag = self._assets[name]
        headers = {**HEADERS, "cache-control": "no-cache", "etag": tag}
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers=headers)
        return Response(content, 200, headers, kind)

    async def events(self, request: Request) -> Response:
        if refusal := self._access.refuse_read(request.headers):
            return refused(refusal)
        if self._streams >= MAX_STREAMS:
            return refused(Refusal(503, f"there are {MAX_STREAMS} clients already"))
        self._streams += 1  # before anything else runs: streams that open together count too
        last = request.headers.get("last-event-id") or request.query_params.get("after", "")
        headers = {**HEADERS, "cache-control": "no-store", "x-accel-buffering": "no"}
        frames = stream(self._page.ring, last, self._wait, lambda: self._closing)
        return _CountedStream(self._stream_ended, frames, 200, headers, "text/event-stream")

    async def history(self, request: Request) -> Response:
        if refusal := self._access.refuse_read(request.headers):
            return refused(refusal)
        text = request.query_params.get("span", "300")
        if not re.fullmatch(r"[0-9]{1,6}", text) or not 1 <= int(text) <= MAX_SPAN:
            return refused(Refusal(400, f"span: expected 1 to {MAX_SPAN:.0f} s"))
        result = await asyncio.to_thread(self._page.history.over, float(text))
        return JSONResponse(result, headers={**HEADERS, "cache-control": "no-store"})

    async def metrics(self, request: Request) -> Response:
        if refusal := self._access.refuse_read(request.headers):
            return refused(refusal)
        text = metrics_text({self._page.twin.rig.name: self._page.metrics})
        return Response(text, 200, {**HEADERS, "content-type": CONTENT_TYPE})

    async def health(self, request: Request) -> Response:
        if refusal := self._access.refuse_read(request.headers):
            return refused(refusal)
        waited = time.monotonic() - self._page.turned
        is_well = waited < STUCK_SECONDS
        content = {"status": "ok" if is_well else "stuck", "loop_age_s": round(waited, 3)}
        headers = {**HEADERS, "cache-control": "no-store"}
        return JSONResponse(content, 200 if is_well else 503, headers)

    async def stop(self, request: Request) -> Response:
        body = await command_body(request, self._access, needs_control=False)
        if isinstance(body, Refusal):
            return refused(body)
        try:
            check_names(fields_of(body), set())
        except JaxtwinError as error:
            return refused(Refusal(400, str(error)))
        asked = self._desk.press_stop()
        try:
            answer = await asyncio.wait_for(asyncio.wrap_future(asked), ANSWER_SECONDS)
        except TimeoutError:
            text = "stopping; the device has not reported yet: the log says what becomes of it"
            return JSONResponse({"text": text}, 202, HEADERS)
        if not answer.obeyed:
            return refused(Refusal(409, answer.text))
        return JSONResponse({"text": answer.text}, 200, HEADERS)

    async def order(self, request: Request) -> Response:
        kind = request.path_params["kind"]
        if kind not in KINDS:
            return refused(Refusal(404, f"expected one of {', '.join(KINDS)}"))
        # Who acknowledges commands nothing.
        needs_control = kind != "acknowledge"
        body = await command_body(request, self._access, needs_control=needs_control)
        if isinstance(body, Refusal):
            return refused(body)
        try:
            outputs = len(self._page.ring.newest_of("layout").get("outputs", ()))
            order = order_of(kind, body, self._page.twin.rig.lowest_duty, outputs)
        except JaxtwinError as error:
            return refused(Refusal(400, str(error)))
        asked = self._desk.ask(order)
        try:
            answer = await asyncio.wait_for(asyncio.wrap_future(asked), ANSWER_SECONDS)
        except TimeoutError:
            if asked.cancel():
                text = f"the rig has obeyed nothing for {ANSWER_SECONDS:g} s; the order is void"
            else:
                text = "the order was taken and takes long; the log says what becomes of it"
            return refused(Refusal(504, text))
        return JSONResponse({"text": answer.text}, 200 if answer.obeyed else 409, HEADERS)

    def _stream_ended(self) -> None:
        self._streams -= 1

    def _table(self) -> str:
        """The readings as rows of a table, for a browser without JavaScript."""
        layout, sample = (self._page.ring.newest_of(kind) for kind in ("layout", "sample"))
        if sample is None:
            return "<tr><td>no reading yet</td><td></td><td></td></tr>"
        names = [channel["name"] for channel in layout["channels"]]
        rows = zip(names, sample["measured"], sample["expected"], strict=True)
        return "".join(
            f"<tr><th scope=row>{html.escape(name)}</th><td>{_degrees(measured)}</td>"
            f"<td>{_degrees(expected)}</td></tr>"
            for name, measured, expected in rows
        )


async def command_body(request: Request, access: Access, *, needs_control: bool) -> bytes | Refusal:
    """The body of a command, if it is allowed, small and fast enough."""
    if refusal := access.refuse_command(request.headers, needs_control=needs_control):
        return refusal

    async def read() -> bytes | Refusal:
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > MAX_BODY:
                return Refusal(413, f"expected at most {MAX_BODY} bytes")
        return body

    try:
        return await asyncio.wait_for(read(), BODY_SECONDS)
    except TimeoutError:
        return Refusal(408, f"expected the body within {BODY_SECONDS:g} s")


@final
class _CountedStream(StreamingResponse):
    """A stream that says when it is over, also if its client has gone before it began."""

    def __init__(self, ended: Callable[[], None], *arguments: Any):
        super().__init__(*arguments)
        self._ended = ended

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._ended()


def _degrees(value: float | None) -> str:
    return "failed" if value is None else f"{value:.1f}"


def asset_files(package: str = "jaxtwin.serve") -> Iterator[tuple[str, tuple[bytes, str, str]]]:
    """Name -> content, type and tag of the files of a page, which are those of a package."""
    places = [("", files(package) / "assets")]
    for prefix, place in places:
        for entry in place.iterdir():
            if entry.is_dir():
                places.append((f"{entry.name}/", entry))
                continue
            content = entry.read_bytes()
            kind = mimetypes.guess_type(entry.name)[0] or "text/plain"
            kind = "text/javascript" if entry.name.endswith(".js") else kind
            tag = f'"{hashlib.sha256(content).hexdigest()[:16]}"'
            yield f"{prefix}{entry.name}", (content, kind, tag)


def refused(refusal: Refusal) -> Response:
    headers: dict[str, Any] = {**HEADERS, "cache-control": "no-store"}
    if refusal.status == 401:
        headers["www-authenticate"] = "Bearer"
    return JSONResponse({"error": refusal.text}, refusal.status, headers)

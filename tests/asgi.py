"""A client of an ASGI application, without a network: requests in, status, headers and body out."""

import asyncio
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

HOST = "127.0.0.1:8000"


class Answer(NamedTuple):
    """The answer to a request; names of headers are in lower case."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


def ask(
    app: Any,
    path: str,
    *,
    method: str = "GET",
    headers: Mapping[str, str | None] | None = None,
    body: Sequence[bytes] = (b"",),
    chunks: int | None = None,
    is_slow: bool = False,
) -> Answer:
    """Sends a request and returns its answer.

    **Arguments:**

    - `headers`: further ones; None removes one.
    - `body`: its parts.
    - `chunks`: the client goes away after so many parts of the answer, as from a stream.
    - `is_slow`: the body never ends.
    """
    return asyncio.run(_ask(app, path, method, headers or {}, list(body), chunks, is_slow))


async def _ask(
    app: Any,
    path: str,
    method: str,
    headers: Mapping[str, str | None],
    body: list[bytes],
    chunks: int | None,
    is_slow: bool,
) -> Answer:
    place, _, query = path.partition("?")
    given = {"host": HOST, **headers}
    scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": method,
        "path": place,
        "raw_path": place.encode(),
        "root_path": "",
        "scheme": "http",
        "query_string": query.encode(),
        "headers": [(k.encode(), v.encode()) for k, v in given.items() if v is not None],
        "client": ("127.0.0.1", 50_000),
        "server": ("127.0.0.1", 8000),
    }
    gone = asyncio.Event()
    started: dict[str, Any] = {}
    parts: list[bytes] = []

    async def receive() -> dict[str, Any]:
        if body:
            part = body.pop(0)
            return {"type": "http.request", "body": part, "more_body": bool(body) or is_slow}
        await gone.wait()
        return {"type": "http.disconnect"}

    async def send(message: Mapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            started.update(message)
            return
        if message.get("body"):
            parts.append(message["body"])
        if chunks is not None and len(parts) >= chunks:
            gone.set()
            await asyncio.sleep(0)  # the application hears that the client has gone

    await app(scope, receive, send)
    found = {k.decode().lower(): v.decode() for k, v in started["headers"]}
    return Answer(started["status"], found, b"".join(parts))

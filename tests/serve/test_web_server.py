"""The web server on a real socket: slow clients are sent away, and streams are bounded."""

import socket
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import pytest
from small_page import page

from jaxtwin.live import StopRequest
from jaxtwin.serve import Access, Desk, listening, web_app
from jaxtwin.serve import _app as app_module
from jaxtwin.serve import _request_timeout_protocol as prompt
from jaxtwin.serve._web_server import WebServer


@pytest.fixture
def port() -> Iterator[int]:
    """The port of a server that runs."""
    opened = listening("127.0.0.1", 0)
    number = opened.getsockname()[1]
    app = web_app(page(), Desk(StopRequest()), Access.of("127.0.0.1", number))
    with WebServer(app, opened):
        yield number


Ask = Callable[[bytes], socket.socket]


@pytest.fixture
def asked(port: int) -> Iterator[Ask]:
    """Opens a connection and sends the beginning of what it asks for."""
    with ExitStack() as stack:

        def ask(begin: bytes) -> socket.socket:
            client = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
            client.settimeout(5.0)
            client.sendall(begin)
            return client

        yield ask


def head(port: int, path: str) -> bytes:
    return f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode()


def answer(client: socket.socket) -> bytes:
    """An answer with its JSON."""
    heard = b""
    while not heard.endswith(b"}"):
        heard += client.recv(1000)
    return heard


def test_a_connection_that_does_not_say_what_it_asks_for_is_closed(
    port: int, asked: Ask, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also one that sends a byte now and then, and one that was used before."""
    monkeypatch.setattr(prompt, "HEAD_SECONDS", 0.4)
    silent = [asked(begin) for begin in (b"", b"GET /hea", head(port, "/healthz")[:-2])]
    used = asked(head(port, "/healthz"))
    assert answer(used).startswith(b"HTTP/1.1 200")
    used.sendall(b"GET /hea")
    dripping = asked(b"G")
    begin = time.monotonic()
    while time.monotonic() - begin < 0.3:
        dripping.sendall(b"G")
        time.sleep(0.05)
    for client in (*silent, used, dripping):
        assert client.recv(1000) == b""
    assert time.monotonic() - begin < 3.0


def test_a_stream_and_a_second_request_outlast_that_time(
    port: int, asked: Ask, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(prompt, "HEAD_SECONDS", 0.3)
    monkeypatch.setattr("jaxtwin.serve._app.KEEPALIVE_SECONDS", 0.1)
    stream = asked(head(port, "/events"))
    again = asked(head(port, "/healthz"))
    begin, heard = time.monotonic(), b""
    while time.monotonic() - begin < 1.0:
        heard = stream.recv(65_536)
        assert heard  # it is not closed
    assert answer(again).startswith(b"HTTP/1.1 200")
    again.sendall(head(port, "/healthz"))
    assert answer(again).startswith(b"HTTP/1.1 200")


def test_streams_that_open_together_are_no_more_than_allowed(
    port: int, asked: Ask, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app_module, "MAX_STREAMS", 20)
    for _ in range(2):  # those that have gone make room
        with ThreadPoolExecutor(30) as threads:
            opened = list(threads.map(lambda _: asked(head(port, "/events")), range(30)))
            first = list(threads.map(lambda one: one.recv(12), opened))
        assert first.count(b"HTTP/1.1 200") == 20
        assert first.count(b"HTTP/1.1 503") == 10
        for client in opened:
            client.close()
        time.sleep(0.5)

"""Fetching by checksum, from a server on this machine."""

import hashlib
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from jaxtwin.errors import RecordingError
from jaxtwin.io import SINGLE_CELL, TWO_CELL, PublishedRecording, fetch_recordings

FILES = {"/a.mat": b"zone A", "/b.mat": b"one cell"}


class Server:
    """Serves FILES on the loopback address and counts what is asked for."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                server.asked.append(self.path)
                content = FILES.get(self.path)
                self.send_response(404 if content is None else 200)
                self.send_header("Content-Length", str(len(content or b"")))
                self.end_headers()
                self.wfile.write(content or b"")

            def log_request(self, code: object = "-", size: object = "-") -> None:
                """Says nothing."""

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)

    def recording(self, path: str, name: str | None = None, content: bytes | None = None):
        """A file of this server, with the checksum of `content`, or else its own."""
        right = FILES.get(path, b"") if content is None else content
        url = f"http://127.0.0.1:{self.http.server_port}{path}"
        return PublishedRecording(name or path[1:], url, hashlib.sha256(right).hexdigest())


@pytest.fixture
def server(monkeypatch) -> Iterator[Server]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    server = Server()
    thread = threading.Thread(target=server.http.serve_forever, args=(0.01,))
    thread.start()
    yield server
    server.http.shutdown()
    thread.join()
    server.http.server_close()


def test_they_are_put_where_they_are_looked_for_and_fetched_once(server, tmp_path):
    recordings = [server.recording("/a.mat"), server.recording("/b.mat", "single-cell/b.mat")]
    said: list[str] = []
    paths = fetch_recordings(tmp_path, recordings, on_progress=said.append)
    assert paths == (tmp_path / "a.mat", tmp_path / "single-cell" / "b.mat")
    assert [path.read_bytes() for path in paths] == [b"zone A", b"one cell"]
    assert said == ["a.mat (1 of 2)", "single-cell/b.mat (2 of 2)"]
    assert fetch_recordings(tmp_path, recordings) == paths
    assert server.asked == ["/a.mat", "/b.mat"]


def test_by_default_into_the_cache(server, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxtwin.io._fetch.cache_folder", lambda: tmp_path / "cache")
    assert fetch_recordings(recordings=[server.recording("/a.mat")]) == (
        tmp_path / "cache" / "a.mat",
    )


def test_a_wrong_checksum_leaves_nothing(server, tmp_path):
    with pytest.raises(RecordingError, match=r"a\.mat: not fetched: .*127.0.0.1.* another SHA-256"):
        fetch_recordings(tmp_path, [server.recording("/a.mat", content=b"what was published")])
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_file_is_replaced_but_not_by_another_damaged_one(server, tmp_path):
    path = tmp_path / "a.mat"
    path.write_bytes(b"damaged")
    with pytest.raises(RecordingError, match="another SHA-256"):
        fetch_recordings(tmp_path, [server.recording("/a.mat", content=b"what was published")])
    assert path.read_bytes() == b"damaged"
    fetch_recordings(tmp_path, [server.recording("/a.mat")])
    assert path.read_bytes() == b"zone A"
    assert list(tmp_path.iterdir()) == [path]


def test_what_was_fetched_before_an_error_stays(server, tmp_path):
    recordings = [server.recording("/a.mat"), server.recording("/none.mat")]
    with pytest.raises(
        RecordingError, match=r"none\.mat: cannot be fetched from http://127.* by hand"
    ):
        fetch_recordings(tmp_path, recordings)
    assert list(tmp_path.iterdir()) == [tmp_path / "a.mat"]


def test_no_server_at_all(tmp_path, monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    recording = PublishedRecording("a.mat", "http://127.0.0.1:1/a.mat", "0" * 64)
    with pytest.raises(RecordingError, match=r"cannot be fetched from .*\(ConnectionError\)"):
        fetch_recordings(tmp_path, [recording])


def test_a_folder_that_cannot_be_made(server, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot be fetched"):
        fetch_recordings(tmp_path / "file", [server.recording("/a.mat")])


def test_the_table_of_published_files_is_well_formed():
    """Each from one commit of the authors' repositories, under its own name."""
    table = TWO_CELL + SINGLE_CELL
    assert len({recording.sha256 for recording in table}) == len(table)
    for recording in table:
        host, owner, _, commit, file = recording.url.removeprefix("https://").split("/")
        assert (host, owner) == ("raw.githubusercontent.com", "tartanus")
        assert len(bytes.fromhex(commit)) == 20
        assert len(bytes.fromhex(recording.sha256)) == 32
        assert recording.name.split("/")[-1] == file

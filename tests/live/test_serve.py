"""A virtual rig behind TCP: one host's noise or silence is no other host's business."""

import socket
from collections.abc import Iterator

import pytest

from jaxtwin.live import Ask, Duty, TcpServer, VirtualRig, encode
from jaxtwin.live.protocol._framing import delines
from jaxtwin.live.virtual_rig._serve import MAX_CLIENTS
from jaxtwin.physics import Twin


@pytest.fixture
def server() -> Iterator[TcpServer]:
    made = TcpServer("127.0.0.1:0")
    yield made
    made.close()


def connected(server: TcpServer) -> socket.socket:
    host, port = server.url.removeprefix("socket://").split(":")
    return socket.create_connection((host, int(port)))


def ticks(server: TcpServer, device: VirtualRig, times: int = 20) -> None:
    for _ in range(times):
        server.tick(b"", device)


@pytest.mark.parametrize("noise", [b"\x00\x02", b"duty n=1 own", b"\x00" * 50, b"x" * 5000])
def test_noise_from_one_host_does_not_hide_commands_of_another(
    twin: Twin, server: TcpServer, noise: bytes
) -> None:
    device = VirtualRig(twin)
    with connected(server) as noisy, connected(server) as other:
        ticks(server, device)
        noisy.sendall(noise)
        ticks(server, device)
        other.sendall(encode(Duty(1, (5, 6), "me")))
        while device.pwm == (0, 0):
            ticks(server, device, 1)
        # Nor for itself, after a newline.
        noisy.sendall(b"\n" + encode(Duty(2, (7, 8), "me")))
        while device.pwm == (5, 6):
            ticks(server, device, 1)
    assert device.pwm == (7, 8)


def test_idle_hosts_make_room_for_one_that_speaks(twin: Twin, server: TcpServer) -> None:
    device = VirtualRig(twin)
    idle = [connected(server) for _ in range(MAX_CLIENTS)]
    ticks(server, device)
    idle[0].sendall(encode(Ask(2)))
    ticks(server, device)
    with connected(server) as late:
        ticks(server, device)
        late.settimeout(10)
        assert late.recv(100).startswith(b"hello version=2")
    # The most silent went; the first, which had spoken, is still there.
    idle[1].settimeout(10)
    rest = b""
    while chunk := idle[1].recv(1000):
        rest += chunk
    idle[0].settimeout(0.05)
    assert idle[0].recv(10_000)
    for client in idle:
        client.close()


def test_a_line_is_found_after_noise_and_across_two_pieces() -> None:
    line = encode(Ask(2))
    for noise in (b"\x00\x02", b"\x00", b"\xff\n", b"x" * 3000 + b"\n"):
        lines, rest = delines(b"", noise + line)
        assert (lines, rest) == (["hello version=2"], b"")
    lines, rest = delines(b"", line[:5])
    assert delines(rest, line[5:]) == (["hello version=2"], b"")

"""MQTT against a real broker: Debian's mosquitto, on loopback."""

import json
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from jaxtwin import JaxtwinError
from jaxtwin.io import Session
from jaxtwin.live import (
    Reading,
    Recorder,
    Sample,
    SystemClock,
    VirtualRig,
    connect,
    opener,
    serve,
)
from jaxtwin.live._mqtt import MqttTransport, Publisher
from jaxtwin.live._serve import MqttServer
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    config = tmp_path / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\n")
    command = [shutil.which("mosquitto") or "mosquitto", "-c", str(config)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    for _ in range(1000):
        try:
            socket.create_connection(("127.0.0.1", port)).close()
            break
        except OSError:
            threading.Event().wait(0.01)
    yield f"127.0.0.1:{port}"
    process.terminate()
    process.wait()


@pytest.mark.mosquitto
def test_a_rig_is_recorded_through_a_broker_and_its_readings_are_published(
    broker: str, rig: Rig, twin: Twin, tmp_path: Path
) -> None:
    url = f"mqtt://{broker}/bench/wire"
    device, stop = VirtualRig(twin, speed=5), threading.Event()
    server = MqttServer(url)
    thread = threading.Thread(target=serve, args=(device, server, SystemClock(), stop))
    thread.start()
    host, port = broker.split(":")
    subscriber = MqttTransport(host, int(port), "bench/json", reads="readings", writes="none")
    publisher = Publisher(f"mqtt://{broker}/bench/json", twin.channels, ("P1", "P2"))
    file = tmp_path / "session.db"
    try:
        with Recorder(file, rig) as recorder, connect(rig, url, journal=recorder) as bench:
            records: list = []
            while sum(isinstance(record, Reading) for record in records) < 20:
                new = bench.poll()
                records += new
                publisher.publish(new)
            # A command goes the other way.
            bench.send_duty((64, -64))
            while not any(isinstance(r, Sample) and r.pwm == (64, -64) for r in records):
                records += bench.poll()
        published = b""
        while b"}" not in published:
            published += subscriber.read()
    finally:
        stop.set()
        thread.join()
        server.close()
        publisher.close()
        subscriber.close()
    first = json.loads(published[: published.index(b"}") + 1])
    readings = [record for record in records if isinstance(record, Reading)]
    assert first["T11"] == pytest.approx(float(readings[0].temperatures[0]), abs=1e-3)
    with Session(file) as session:
        lost = session.database.execute("SELECT coalesce(sum(count), 0) FROM gaps").fetchone()[0]
    assert lost == 0


@pytest.mark.mosquitto
def test_a_broker_that_goes_away_is_a_lost_link(broker: str) -> None:
    transport = opener(f"mqtt://{broker}/topic")()
    assert transport.read() == b""
    assert isinstance(transport, MqttTransport)
    transport._client.socket().shutdown(socket.SHUT_RDWR)
    while not transport._lost:
        threading.Event().wait(0.01)
    with pytest.raises(OSError, match="the broker is gone"):
        transport.read()
    transport.close()


def test_a_topic_is_needed() -> None:
    with pytest.raises(JaxtwinError, match="allowed is mqtt://host:port/topic"):
        Publisher("mqtt://127.0.0.1", ("T11",), ("P1",))

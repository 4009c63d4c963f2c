"""A real broker for the tests of MQTT: Debian's mosquitto, on loopback."""

import contextlib
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

from jaxtwin.live.protocol._mqtt_transport import MqttAddress, MqttTransport


@contextlib.contextmanager
def running_broker(folder: Path, options: str) -> Iterator[str]:
    """A broker on a free port, with further lines of its file; `host:port`."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    config = folder / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\npersistence false\n{options}")
    command = [shutil.which("mosquitto") or "mosquitto", "-c", str(config)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    for _ in range(1000):
        try:
            socket.create_connection(("127.0.0.1", port)).close()
            break
        except OSError:
            threading.Event().wait(0.01)
    try:
        yield f"127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait()


def topic_client(url: str, *, reads: str = "none", writes: str = "none") -> MqttTransport:
    """A client of `mqtt://host:port/topic`, and the parts that it reads and writes: `alerts`."""
    return MqttTransport(MqttAddress.parse(url), reads=reads, writes=writes)

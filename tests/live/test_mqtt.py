"""MQTT against a real broker: Debian's mosquitto, on loopback."""

import json
import socket
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from folded import feed
from mosquitto import running_broker

from jaxtwin import JaxtwinError, load_rig
from jaxtwin.io import Session
from jaxtwin.live import (
    Duty,
    Event,
    Finding,
    Publisher,
    Reading,
    Recorder,
    RigState,
    Sample,
    Service,
    StateEstimate,
    SystemClock,
    VirtualRig,
    connect,
    encode,
    opener,
    serve,
)
from jaxtwin.live.protocol._mqtt_transport import (
    MAX_MESSAGE_BYTES,
    MqttAddress,
    MqttTransport,
    without_password,
)
from jaxtwin.live.virtual_rig._serve import MqttServer
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig

RIG = load_rig("dual-cell")


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[str]:
    with running_broker(tmp_path, "allow_anonymous true\n") as address:
        yield address


@pytest.mark.mosquitto
def test_a_rig_is_recorded_through_a_broker_and_its_readings_are_published(
    broker: str, rig: Rig, twin: Twin, tmp_path: Path
) -> None:
    url = f"mqtt://{broker}/bench/wire"
    device, stop = VirtualRig(twin, speed=5), threading.Event()
    server = MqttServer(url)
    thread = threading.Thread(target=serve, args=(device, server, SystemClock(), stop))
    thread.start()
    json_topic = MqttAddress.parse(f"mqtt://{broker}/bench/json")
    subscriber = MqttTransport(json_topic, reads="readings", writes="none")
    publisher = Publisher(f"mqtt://{broker}/bench/json", rig)
    file = tmp_path / "session.db"
    try:
        with Recorder(file, rig) as recorder, connect(rig, url, journal=recorder) as bench:
            records: list = []
            service = Service(bench, [publisher])
            while sum(isinstance(record, Reading) for record in records) < 20:
                records += service.turn()
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
    transport = opener(f"mqtt://{broker}/topic", RIG)()
    assert transport.read() == b""
    assert isinstance(transport, MqttTransport)
    transport._client.socket().shutdown(socket.SHUT_RDWR)
    while not transport._lost:
        threading.Event().wait(0.01)
    with pytest.raises(OSError, match="the broker is gone"):
        transport.read()
    transport.close()


@pytest.mark.mosquitto
def test_a_retained_command_and_an_oversized_message_do_not_reach_a_device(broker: str) -> None:
    address = MqttAddress.parse(f"mqtt://{broker}/rig")
    host = MqttTransport(address)
    command = encode(Duty(1, (255, 255), "me"))
    host._client.publish("rig/down", command, qos=1, retain=True).wait_for_publish()
    device = MqttTransport(address, reads="down", writes="up")
    host._client.publish("rig/down", b"x" * (MAX_MESSAGE_BYTES + 1), qos=1).wait_for_publish()
    host.write(b"beat t=1")
    received = b""
    while not received:
        received = device.read()
    assert received == b"beat t=1"
    host.close()
    device.close()


@pytest.mark.slow
@pytest.mark.mosquitto
def test_user_and_password_of_the_address_are_used(tmp_path: Path) -> None:
    passwords = tmp_path / "passwords"
    subprocess.run(["mosquitto_passwd", "-b", "-c", passwords, "anna", "s:c"], check=True)
    options = f"allow_anonymous false\npassword_file {passwords}\nuser root\n"
    with running_broker(tmp_path, options) as broker:
        MqttTransport(MqttAddress.parse(f"mqtt://anna:s%3Ac@{broker}/t")).close()
        with pytest.raises(TimeoutError, match="refuses"):
            MqttTransport(MqttAddress.parse(f"mqtt://{broker}/t"))


@pytest.mark.slow
@pytest.mark.mosquitto
# paho leaves the socket of a handshake that failed to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_link_is_encrypted_and_asks_for_certificates(tmp_path: Path) -> None:
    """A broker that wants a certificate of its clients, and a client that checks the broker's."""

    def openssl(*words: str) -> None:
        subprocess.run(["openssl", *words], cwd=tmp_path, check=True, capture_output=True)

    new = ("-nodes", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1")
    openssl("req", "-x509", *new, "-keyout", "ca.key", "-out", "ca.pem", "-subj", "/CN=ca")
    for name in ("broker", "anna"):
        files = "-keyout", f"{name}.key", "-out", f"{name}.csr"
        openssl("req", *new, *files, "-subj", f"/CN={name}")
        (tmp_path / "names").write_text("subjectAltName=IP:127.0.0.1")
        signer = "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-extfile", "names"
        openssl("x509", "-req", "-in", f"{name}.csr", *signer, "-out", f"{name}.pem")
    at = tmp_path
    options = f"cafile {at}/ca.pem\ncertfile {at}/broker.pem\nkeyfile {at}/broker.key\n"
    options += "require_certificate true\nuse_identity_as_username true\nuser root\n"
    with running_broker(tmp_path, options) as broker:
        url = f"mqtts://{broker}/t?ca={at}/ca.pem"
        own = MqttTransport(MqttAddress.parse(f"{url}&cert={at}/anna.pem&key={at}/anna.key"))
        own.write(b"over TLS")
        own.close()
        for refused in (
            url,  # without its own certificate
            f"mqtts://{broker}/t",  # the broker's is of no authority that the system knows
            f"mqtt://{broker}/t",  # not encrypted
        ):
            with pytest.raises(OSError, match=r".+"):
                MqttTransport(MqttAddress.parse(refused))


@pytest.mark.mosquitto
def test_an_alarm_reaches_subscribers(broker: str, rig: Rig) -> None:
    subscriber = MqttTransport(
        MqttAddress.parse(f"mqtt://{broker}/bench"), reads="events", writes="none"
    )
    publisher = Publisher(f"mqtt://{broker}/bench", rig)
    alarm = Event("", 10**9, "alarm", "over-temperature: T11 is at 91.0 degC")
    feed(publisher, [alarm], alarm.arrival, RigState())
    received = b""
    while b"}" not in received:
        received += subscriber.read()
    publisher.close()
    subscriber.close()
    assert json.loads(received) == {
        "link": "",
        "event": "alarm",
        "detail": "over-temperature: T11 is at 91.0 degC",
        "time": 1.0,
    }


@pytest.mark.mosquitto
def test_estimates_and_findings_reach_subscribers(broker: str, rig: Rig) -> None:
    def listening_to(topic: str) -> MqttTransport:
        address = MqttAddress.parse(f"mqtt://{broker}/bench")
        return MqttTransport(address, reads=topic, writes="none")

    def received(subscriber: MqttTransport) -> dict[str, Any]:
        content = b""
        while b"}" not in content:
            content += subscriber.read()
        subscriber.close()
        return json.loads(content)

    estimates, findings = listening_to("estimates"), listening_to("findings")
    publisher = Publisher(f"mqtt://{broker}/bench", rig)
    publisher.send(StateEstimate(2 * 10**9, "mine", {"room_degC": 21.5, "room_spread_K": 0.2}))
    publisher.send_finding(
        Finding("drift", "T11 drifts", channel="T11", since=10**9, size=2.0, unit="K")
    )
    assert received(estimates) == {
        "twin": "mine",
        "room_degC": 21.5,
        "room_spread_K": 0.2,
        "time": 2.0,
    }
    found = received(findings)
    publisher.close()
    assert (found["kind"], found["channel"], found["size"], found["unit"]) == (
        "drift",
        "T11",
        2.0,
        "K",
    )
    assert (found["since"], found["until"]) == (1.0, None)


def test_an_address_says_all_that_a_broker_wants() -> None:
    url = "mqtts://anna:s%3Ac@host:9/a/b?ca=ca.pem&cert=c.pem&key=k.pem"
    address = MqttAddress.parse(url)
    assert address == MqttAddress("host", 9, "a/b", "anna", "s:c", True, "ca.pem", "c.pem", "k.pem")
    assert "s:c" not in repr(address)
    assert MqttAddress.parse("mqtts://host/t").port == 8883
    assert "s%3Ac" not in without_password(url)
    assert without_password(url).startswith("mqtts://anna:***@host:9/a/b")
    assert without_password("socket://h:1") == "socket://h:1"
    assert without_password("--link=mqtt://a:b@h:1/t") == "--link=mqtt://a:***@h:1/t"
    assert without_password("mqtt://a@h:1/t@x:y@z") == "mqtt://a@h:1/t@x:y@z"


@pytest.mark.parametrize(
    "url",
    [
        "mqtt://127.0.0.1",
        "mqtt://h:x/t",
        "mqtt://h/t/#",
        "mqtt://h/+/t",
        "mqtt://h/t?ca=f",
        "mqtts://h/t?cert=f",
        "mqtts://h/t?other=f",
    ],
)
def test_an_invalid_address_is_refused_with_what_is_expected(url: str, rig: Rig) -> None:
    with pytest.raises(JaxtwinError, match="expected"):
        Publisher(url, rig)


def test_a_password_stands_in_no_error_and_in_no_name_of_a_link(rig: Rig) -> None:
    with pytest.raises(JaxtwinError) as refused:
        opener("mqtt://anna:secret@h/#", RIG)
    assert "secret" not in str(refused.value)
    bench = connect(rig, "mqtt://anna:secret@127.0.0.1:1/t")
    assert set(bench.states) == {"mqtt://anna:***@127.0.0.1:1/t"}

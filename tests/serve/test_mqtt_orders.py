"""Orders to a store from a broker: each is taken as that of the page, and answered."""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from mosquitto import running_broker, topic_client
from small_page import twin

from jaxtwin.errors import LinkError
from jaxtwin.live import Publisher, StopRequest
from jaxtwin.serve import Desk
from jaxtwin.serve._desk import Answer, Asked, PromoteOrder
from jaxtwin.serve._orders import MqttOrders

pytestmark = pytest.mark.mosquitto

# How long a message is waited for: one that is lost must fail a test, not hang it.
PATIENCE_SECONDS = 30.0


class Client:
    """Who gives orders, and hears the answers."""

    def __init__(self, broker: str):
        url = f"mqtt://{broker}/bench"
        self._answers = topic_client(url, reads="answers")
        self._orders = {
            kind: topic_client(url, writes=f"orders/{kind}") for kind in ("promote", "drive")
        }

    def order(self, kind: str, body: bytes) -> None:
        self._orders[kind].write(body)

    def answer(self) -> dict[str, Any]:
        content, end = b"", time.monotonic() + PATIENCE_SECONDS
        while b"}" not in content and time.monotonic() < end:
            content += self._answers.read()
        return json.loads(content)

    def close(self) -> None:
        for link in (self._answers, *self._orders.values()):
            link.close()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[str]:
    with running_broker(tmp_path, "allow_anonymous true\n") as address:
        yield address


@pytest.fixture
def publisher(broker: str) -> Iterator[Publisher]:
    publisher = Publisher(f"mqtt://{broker}/bench", twin().rig)
    yield publisher
    publisher.close()


@pytest.fixture
def client(broker: str) -> Iterator[Client]:
    client = Client(broker)
    yield client
    client.close()


def taken(desk: Desk) -> Asked:
    """The next order at the desk."""
    end = time.monotonic() + PATIENCE_SECONDS
    while (asked := desk.next()) is None and time.monotonic() < end:
        time.sleep(0.01)
    assert asked is not None, "no order has come"
    return asked


def test_a_version_is_promoted_and_the_answer_is_published(
    publisher: Publisher, client: Client
) -> None:
    desk = Desk(StopRequest())
    MqttOrders(publisher, desk)
    client.order("promote", b'{"version": "challenger", "reason": "the trial was passed"}')
    asked = taken(desk)
    assert asked.order == PromoteOrder("challenger", "the trial was passed")
    # Nothing else is taken before it is answered.
    client.order("promote", b'{"version": 3, "reason": "again"}')
    assert client.answer() == {
        "order": "promote",
        "obeyed": False,
        "text": "expected one order at a time; the one before is not answered",
    }
    asked.answer(Answer(True, "version 2 is the champion"))
    assert client.answer() == {
        "order": "promote",
        "obeyed": True,
        "text": "version 2 is the champion",
    }
    assert desk.next() is None


@pytest.mark.parametrize(
    ("body", "text"),
    [
        (b"heat!", "expected JSON"),
        (b'{"version": 1, "reason": ""}', "reason: expected"),
        (b'{"versio": 1}', "expected reason, version, got 'versio'"),
        (b'{"version": "' + b"1" * 5000 + b'"}', "expected at most 4096 bytes"),
    ],
)
def test_what_is_no_order_is_refused(
    publisher: Publisher, client: Client, body: bytes, text: str
) -> None:
    desk = Desk(StopRequest())
    MqttOrders(publisher, desk)
    client.order("promote", body)
    answer = client.answer()
    assert (answer["order"], answer["obeyed"]) == ("promote", False)
    assert text in answer["text"]
    assert desk.next() is None


def test_nobody_drives_a_rig_by_a_broker(publisher: Publisher, client: Client) -> None:
    desk = Desk(StopRequest())
    MqttOrders(publisher, desk)
    client.order("drive", b'{"duty": [1.0], "seconds": 60}')
    client.order("promote", b"{}")  # whose refusal comes after it
    assert client.answer()["order"] == "promote"
    assert desk.next() is None


def test_a_retained_order_of_yesterday_is_passed_over(broker: str, client: Client) -> None:
    with_retained = client._orders["promote"]._client
    order = b'{"version": 1, "reason": "yesterday"}'
    with_retained.publish("bench/orders/promote", order, qos=1, retain=True).wait_for_publish(5)
    desk, publisher = Desk(StopRequest()), Publisher(f"mqtt://{broker}/bench", twin().rig)
    MqttOrders(publisher, desk)
    client.order("promote", b'{"version": 2, "reason": "today"}')
    assert taken(desk).order == PromoteOrder("2", "today")
    assert desk.next() is None
    publisher.close()


def test_a_broker_that_allows_no_orders_is_named(
    publisher: Publisher, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mosquitto's own rules never refuse a subscription; those of other brokers do."""

    def refused(topic: str, qos: int) -> tuple[int, int]:
        publisher._on_subscribe(None, None, 7, [SimpleNamespace(is_failure=True)], None)
        return 0, 7

    monkeypatch.setattr(publisher._client, "subscribe", refused)
    with pytest.raises(LinkError, match="bench/orders/promote: the broker refuses"):
        MqttOrders(publisher, Desk(StopRequest()))

"""Orders to the store of a rig from an MQTT broker, with the rules of those of the page."""

from concurrent.futures import Future
from typing import final

from ..errors import JaxtwinError
from ..live import Publisher
from ._access import MAX_BODY
from ._desk import Answer, Desk
from ._orders import order_of

# The orders that are taken, the ends of their topics: none of them drives a rig.
MQTT_KINDS = ("promote", "rollback", "refit", "acknowledge")


@final
class MqttOrders:
    """Takes orders from `TOPIC/orders/KIND`, whose messages are the JSON of the same orders of the
    page, and answers each on `TOPIC/answers`. Who may publish there is the broker's to say.

    One order is taken at a time: a flood of them is refused, and never fills the desk.

    **Arguments:**

    - `publisher`: the connection to the broker.
    - `desk`: where the orders are left.
    """

    def __init__(self, publisher: Publisher, desk: Desk):
        self._publisher, self._desk = publisher, desk
        self._waiting: Future[Answer] | None = None
        for kind in MQTT_KINDS:
            publisher.subscribe(f"orders/{kind}", lambda body, kind=kind: self._hear(kind, body))

    def _hear(self, kind: str, body: bytes) -> None:
        try:
            if len(body) > MAX_BODY:
                raise JaxtwinError(f"expected at most {MAX_BODY} bytes")
            if self._waiting is not None and not self._waiting.done():
                raise JaxtwinError("expected one order at a time; the one before is not answered")
            order = order_of(kind, body, (), 0)
        except JaxtwinError as error:
            self._publisher.send_answer(kind, False, str(error))
            return
        self._waiting = self._desk.ask(order)

        def answered(done: "Future[Answer]") -> None:
            self._publisher.send_answer(kind, *done.result())

        self._waiting.add_done_callback(answered)

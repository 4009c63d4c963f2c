"""Every command without the token, from elsewhere, of another form, too large or too slow is
refused, and nothing happens."""

import json
import math
from dataclasses import asdict
from typing import Any

import pytest
from asgi import HOST, ask
from hypothesis import given, settings
from hypothesis import strategies as st
from small_page import TOKEN, bench

from jaxtwin import JaxtwinError
from jaxtwin.serve import Access, _app
from jaxtwin.serve._orders import KINDS, order_of

GOOD = {
    "origin": f"http://{HOST}",
    "content-type": "application/json",
    "authorization": f"Bearer {TOKEN}",
}
DRIVE = json.dumps({"duty": [0.1, 0.2], "seconds": 60}).encode()

REFUSED: dict[str, tuple[int, dict[str, Any]]] = {
    # who
    "no token": (401, {"headers": {"authorization": None}}),
    "an empty token": (401, {"headers": {"authorization": "Bearer "}}),
    "a wrong token": (401, {"headers": {"authorization": "Bearer wrong"}}),
    "the token's beginning": (401, {"headers": {"authorization": f"Bearer {TOKEN[:-1]}"}}),
    "the token and more": (401, {"headers": {"authorization": f"Bearer {TOKEN}x"}}),
    "the token in capitals": (401, {"headers": {"authorization": f"Bearer {TOKEN.upper()}"}}),
    "the token as a password": (401, {"headers": {"authorization": f"Basic {TOKEN}"}}),
    "the token alone": (401, {"headers": {"authorization": TOKEN}}),
    "the token in the address": (
        401,
        {"path": f"/control/stop?token={TOKEN}", "headers": {"authorization": None}},
    ),
    "the token in a cookie": (
        401,
        {"headers": {"authorization": None, "cookie": f"token={TOKEN}"}},
    ),
    # from where
    "no host": (403, {"headers": {"host": ""}}),
    "another host": (403, {"headers": {"host": "evil.example"}}),
    "another host that resolves to this machine": (403, {"headers": {"host": "evil.example:8000"}}),
    "another port": (403, {"headers": {"host": "127.0.0.1:9000"}}),
    "no port": (403, {"headers": {"host": "127.0.0.1"}}),
    "a host with a user": (403, {"headers": {"host": f"user@{HOST}"}}),
    "two hosts": (403, {"headers": {"host": f"{HOST},{HOST}"}}),
    "no origin": (403, {"headers": {"origin": None}}),
    "another origin": (403, {"headers": {"origin": "http://evil.example"}}),
    "an origin of another port": (403, {"headers": {"origin": "http://127.0.0.1:9000"}}),
    "an origin of another name of this machine": (
        403,
        {"headers": {"origin": "http://localhost:8000"}},
    ),
    "the origin of a file": (403, {"headers": {"origin": "null"}}),
    "an origin of another scheme": (403, {"headers": {"origin": f"ftp://{HOST}"}}),
    "an origin that begins well": (403, {"headers": {"origin": f"http://{HOST}.evil.example"}}),
    "a browser that says it is another site": (403, {"headers": {"sec-fetch-site": "cross-site"}}),
    "a page of the same site": (403, {"headers": {"sec-fetch-site": "same-site"}}),
    # how
    "GET": (405, {"method": "GET"}),
    "PUT": (405, {"method": "PUT"}),
    "DELETE": (405, {"method": "DELETE"}),
    "OPTIONS": (405, {"method": "OPTIONS"}),
    "HEAD": (405, {"method": "HEAD"}),
    "POST of the page": (405, {"path": "/"}),
    "POST of the history": (405, {"path": "/history"}),
    "a form": (415, {"headers": {"content-type": "application/x-www-form-urlencoded"}}),
    "plain text": (415, {"headers": {"content-type": "text/plain"}}),
    "no type": (415, {"headers": {"content-type": None}}),
    "a packed body": (415, {"headers": {"content-encoding": "gzip"}}),
    "a length that is none": (400, {"headers": {"content-length": "-1"}}),
    "a length of much": (413, {"headers": {"content-length": "5000"}}),
    "a body of much": (413, {"body": [b" " * 3000, b" " * 3000]}),
    # what
    "no JSON": (400, {"body": [b"stop"]}),
    "a list": (400, {"body": [b"[]"]}),
    "a stop with fields": (400, {"body": [b'{"duty": [0, 0]}']}),
    "deep JSON": (400, {"body": [b"[" * 4000]}),
    "an unknown order": (404, {"path": "/control/shutdown"}),
    "an order in capitals": (404, {"path": "/control/STOP"}),
    "a path around": (404, {"path": "/control/../control/stop"}),
}

ORDERS = {
    "no duty": {"seconds": 60},
    "a duty for one": {"duty": [0.1], "seconds": 60},
    "a duty for three": {"duty": [0.1, 0.1, 0.1], "seconds": 60},
    "a number": {"duty": 0.1, "seconds": 60},
    "text": {"duty": ["0.1", "0.1"], "seconds": 60},
    "too much": {"duty": [1.1, 0], "seconds": 60},
    "a heater that cools": {"duty": [-0.1, 0], "seconds": 60},
    "true": {"duty": [True, 0], "seconds": 60},
    "no time": {"duty": [0, 0]},
    "no time at all": {"duty": [0, 0], "seconds": 0},
    "a year": {"duty": [0, 0], "seconds": 3e7},
    "reset as text": {"duty": [0, 0], "seconds": 60, "reset": "no"},
    "a field more": {"duty": [0, 0], "seconds": 60, "owner": "me"},
}


def refused(path: str = "/control/stop", **more: Any) -> Any:
    method, headers = more.pop("method", "POST"), more.pop("headers", {})
    return ask(bench().app, path, method=method, headers={**GOOD, **headers}, **more)


@pytest.mark.slow
@pytest.mark.parametrize("case", REFUSED)
def test_a_command_is_refused(case: str) -> None:
    status, request = REFUSED[case]
    answer = refused(**request)
    assert answer.status == status
    assert not bench().desk.stop.is_set()
    assert bench().desk.next() is None
    assert TOKEN.encode() not in answer.body


def test_there_are_at_least_thirty_of_them() -> None:
    assert len(REFUSED) >= 30


@pytest.mark.parametrize("case", ORDERS)
def test_an_order_that_is_none_names_the_field(case: str) -> None:
    answer = refused("/control/drive", body=[json.dumps(ORDERS[case]).encode()])
    assert answer.status == 400
    assert "expected" in answer.json["error"]
    assert bench().desk.next() is None


@pytest.mark.parametrize("references", [None, [30.0], "warm", [True], [-300.0]])
def test_references_that_are_none_are_refused(references: object) -> None:
    """Without a controller there are no outputs."""
    body = json.dumps({"references": references, "seconds": 60}).encode()
    answer = refused("/control/hold", body=[body])
    assert answer.status == 400
    assert "references: expected a list of 0 numbers" in answer.json["error"]


@pytest.mark.parametrize("seconds", [0, 299, 1501, "900", None, True])
def test_a_refit_to_too_little_or_to_more_than_is_kept_is_refused(seconds: object) -> None:
    answer = refused("/control/refit", body=[json.dumps({"seconds": seconds}).encode()])
    assert answer.status == 400
    assert "300 to 1500" in answer.json["error"]


@pytest.mark.parametrize("text", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_a_duty_that_is_no_number_is_refused(text: str) -> None:
    """Python's reader of JSON takes them."""
    body = f'{{"duty": [{text}, 0], "seconds": 60}}'.encode()
    assert refused("/control/drive", body=[body]).status == 400


@pytest.mark.parametrize("text", ["1" + "0" * 3000, "-1" + "0" * 3000])
@pytest.mark.parametrize("kind", ["drive", "refit", "promote"])
def test_a_number_of_3000_digits_is_refused_in_a_sentence(kind: str, text: str) -> None:
    """It is too large for a float, and for the numbers of a store."""
    fields = {
        "drive": ("seconds", '"duty": [0, 0], "seconds"'),
        "refit": ("seconds", '"seconds"'),
        "promote": ("version", '"reason": "better", "version"'),
    }
    name, content = fields[kind]
    answer = refused(f"/control/{kind}", body=[f"{{{content}: {text}}}".encode()])
    assert answer.status == 400
    assert answer.json["error"].startswith(f"{name}: expected")
    assert len(answer.json["error"]) < 200


names = st.sampled_from(["duty", "seconds", "reset", "references", "version", "reason"])
values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.integers(10**300, 10**400)
    | st.floats()
    | st.text(st.characters()),  # also halves of characters of UTF-16
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)
plausible = st.fixed_dictionaries(
    {},
    optional={
        "duty": st.lists(st.floats(-1, 1) | values, max_size=2) | values,
        "references": st.lists(st.floats(0, 50) | values, max_size=2) | values,
        "seconds": st.integers(1, 1000) | values,
        "reset": st.booleans() | values,
        "version": st.integers(1, 9) | values,
        "reason": st.text(st.characters(), max_size=400) | values,
    },
)


@given(
    st.sampled_from(KINDS),
    plausible.map(json.dumps).map(str.encode)
    | st.dictionaries(names | st.text(), values, max_size=3).map(json.dumps).map(str.encode)
    | values.map(json.dumps).map(str.encode)
    | st.binary(max_size=50),
)
@settings(max_examples=1000)
def test_any_body_is_an_order_or_refused_in_a_sentence(kind: str, body: bytes) -> None:
    """And what is an order can be obeyed: its numbers are finite, its text can be stored."""
    try:
        order = order_of(kind, body, [0.0, 0.0], 2)
    except JaxtwinError as error:
        json.dumps(str(error), ensure_ascii=False).encode()  # the answer can be sent
        return
    for value in asdict(order).values():
        numbers = [*value] if isinstance(value, tuple) else [value]
        assert all(math.isfinite(one) for one in numbers if isinstance(one, float))
        if isinstance(value, str):
            assert value.encode()
            assert not value.isdecimal() or int(value) < 2**63


def test_a_body_that_does_not_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_app, "BODY_SECONDS", 0.01)
    assert refused(body=[b"{"], is_slow=True).status == 408
    assert not bench().desk.stop.is_set()


@pytest.mark.parametrize("kind", ["drive", "hold", "promote", "rollback", "refit"])
def test_a_page_that_only_shows_takes_no_order_even_with_the_token(kind: str) -> None:
    shown = bench(allow_control=False)
    answer = ask(shown.app, f"/control/{kind}", method="POST", headers=GOOD, body=[DRIVE])
    assert answer.status == 403
    assert "--allow-control" in answer.json["error"]
    assert shown.desk.next() is None


def test_who_has_the_token_may_always_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody takes it here, which the answer says."""
    monkeypatch.setattr(_app, "ANSWER_SECONDS", 0.05)
    shown = bench(allow_control=False)
    assert ask(shown.app, "/control/stop", method="POST", headers=GOOD).status == 202
    assert shown.desk.stop.is_set()
    assert not shown.desk.is_over  # the rig stops, the program goes on
    assert shown.desk.take_stop()
    assert not shown.desk.stop.is_set()


@pytest.mark.parametrize("path", ["/", "/events", "/history", "/metrics", "/healthz"])
def test_reading_is_refused_to_another_name_and_another_origin(path: str) -> None:
    """A page of another site whose name resolves to this machine must not read the rig."""
    for headers in ({"host": "evil.example:8000"}, {"origin": "http://evil.example"}):
        assert ask(bench().app, path, headers=headers).status == 403


def test_names_of_a_proxy_are_allowed_when_they_are_given() -> None:
    rules = Access.of("127.0.0.1", 8000, names=("Rig.Example.org",))
    assert rules.refuse_read({"host": "rig.example.org"}) is None
    assert (
        rules.refuse_read({"host": "rig.example.org", "origin": "https://rig.example.org"}) is None
    )
    assert rules.refuse_read({"host": "rig.example.org:8000"}) is not None


def test_tokens_are_long_and_never_the_same() -> None:
    tokens = {Access.of("127.0.0.1", 8000).token for _ in range(50)}
    assert len(tokens) == 50
    assert min(map(len, tokens)) >= 32

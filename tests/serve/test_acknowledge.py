"""A finding stays in the first answer until somebody acknowledges it, or until another twin follows
the rig."""

import numpy as np
import pytest
from small_page import TOKEN, bench, page, read, twin

from jaxtwin.serve import Page, TwinBeside
from jaxtwin.serve._desk import AcknowledgeOrder
from jaxtwin.serve._orders import order_of


def headline(shown: Page) -> tuple[str, str, int]:
    story = shown.ring.newest_of("story")
    return story["rig"]["level"], story["rig"]["head"], story["new"]


@pytest.fixture(name="shown")
def make_shown() -> Page:
    """A page of a rig one of whose sensors was off for some time, which is over."""
    shown, state = page(), None
    random = np.random.default_rng(0)
    for second in range(400):
        off = 12.0 if 150 <= second < 170 else 0.0
        values = 23.0 + random.normal(0, 0.15, 2) + [off, 0.0]
        state = read(shown, list(values), second, state)
        if second == 160:
            level, head, _ = headline(shown)
            assert (level, "T1" in head) == ("warning", True)
    assert not shown.present
    return shown


def test_a_finding_that_is_over_stays_in_the_headline_until_it_is_acknowledged(shown: Page) -> None:
    level, head, new = headline(shown)
    assert (level, head[:8]) == ("notice", "Over: T1")
    assert new > 0
    story = shown.ring.newest_of("story")
    assert story["rig"]["until"] > story["rig"]["since"]
    shown.acknowledge()
    read(shown, [23.0, 23.0], 401)
    assert headline(shown) == ("good", "The rig is well", 0)


def test_another_twin_begins_without_it(shown: Page) -> None:
    shown.follow(TwinBeside(twin(), "another"))
    read(shown, [23.0, 23.0], 401)
    assert headline(shown)[0] == "good"


def test_a_diagnosis_names_the_reason_and_its_time(shown: Page) -> None:
    best = {
        "name": "offset T1", "phrase": "T1 reads +12 K off", "probability": 0.99, "onset": 7.0,
    }  # fmt: skip
    causes = [{"until_s": None, "explanations": [best]}]
    shown.show_diagnosis({"state": "done", "causes": causes})
    read(shown, [23.0, 23.0], 401)
    assert headline(shown)[:2] == ("warning", "T1 reads +12 K off")
    assert shown.ring.newest_of("story")["rig"]["since"] == 7.0


def test_who_has_the_token_may_acknowledge_without_control() -> None:
    """It commands nothing; nobody takes orders from the desk of this bench, so the answer waits."""
    assert order_of("acknowledge", b"{}", (), 0) == AcknowledgeOrder()
    access = bench(allow_control=False).access
    headers = {
        "host": "127.0.0.1:8000", "origin": "http://127.0.0.1:8000",
        "content-type": "application/json", "authorization": f"Bearer {TOKEN}",
    }  # fmt: skip
    assert access.refuse_command(headers, needs_control=False) is None
    assert access.refuse_command(headers, needs_control=True) is not None

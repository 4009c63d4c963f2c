"""The numbers in the documentation are those of the code.

Each row is a sentence of a page with a gap, into which the number of the code is put.
"""

import importlib
from functools import cache
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parent.parent

LIVE = "jaxtwin.live."
KIB, MIB, GIB = 2**10, 2**20, 2**30

NUMBERS = [
    (
        "docs/protocol.md",
        "and a newline. It has at most {} bytes.",
        LIVE + "protocol._framing.LINE_BYTES",
        1,
    ),
    ("docs/protocol.md", "at most {} entries.", LIVE + "protocol._messages.MAX_NAMES", 1),
    (
        "docs/protocol.md",
        "is that of the rig file: 1 to {} characters",
        LIVE + "protocol._identity.MAX_NAME",
        1,
    ),
    ("docs/protocol.md", "repeats it every {} s", LIVE + "_operate.INTERVAL", 1),
    (
        "docs/protocol.md",
        "and ends after {} s without driving",
        LIVE + "_readiness.MAX_REFUSAL_SECONDS",
        1,
    ),
    (
        "docs/protocol.md",
        "after {} bytes without a valid",
        LIVE + "protocol._receiver.MAX_GARBAGE",
        1,
    ),
    (
        "docs/protocol.md",
        "at more than {} messages in a second",
        LIVE + "protocol._receiver.MAX_MESSAGES",
        1,
    ),
    (
        "docs/protocol.md",
        "16 bits each, in units of {} K",
        LIVE + "protocol._identity.CENTIKELVIN",
        1,
    ),
    ("docs/reliability.md", "packets to {} kB", LIVE + "protocol._framing.PACKET_BYTES", KIB),
    ("docs/reliability.md", "lines to {} kB", LIVE + "protocol._framing.LINE_BYTES", KIB),
    ("docs/reliability.md", "a `hello` to {} names", LIVE + "protocol._messages.MAX_NAMES", 1),
    (
        "docs/reliability.md",
        "*implausible* beyond {} K",
        LIVE + "safety._operating_limits.MAX_ROOM_DIFFERENCE_KELVIN",
        1,
    ),
    (
        "docs/reliability.md",
        "{} s at full duty with a camera,",
        LIVE + "safety._operating_limits._FROZEN_CAMERA",
        1,
    ),
    (
        "docs/reliability.md",
        ", {} s with sensors",
        LIVE + "safety._operating_limits._FROZEN_SENSOR",
        1,
    ),
    (
        "docs/live.md",
        "rig file by more than {} K;",
        LIVE + "safety._operating_limits.MAX_ROOM_DIFFERENCE_KELVIN",
        1,
    ),
    ("docs/live.md", "less than {} GiB of free space", LIVE + "_alarms.DISK_BYTES", GIB),
    (
        "docs/live.md",
        "freezes the picture for {} s",
        "jaxtwin.physics._sensors.SHUTTER_SECONDS",
        1,
    ),
    ("docs/live.md", "more than {} MiB is waiting", LIVE + "virtual_rig._serve.MAX_UNSENT", MIB),
    ("docs/cluster.md", "{} draws, or fewer where whole", "jaxtwin.simulation._draw_units.UNIT", 1),
    (
        "docs/performance.md",
        "folder, which holds at most {} GiB",
        "jaxtwin._compilation._store.MAX_CACHE",
        GIB,
    ),
]


@cache
def page(name: str) -> str:
    return (CHECKOUT / name).read_text()


def constant(path: str) -> float:
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


@pytest.mark.parametrize(("name", "sentence", "path", "unit"), NUMBERS)
def test_a_number_of_the_documentation_is_that_of_the_code(name, sentence, path, unit):
    number = constant(path) / unit
    plain = f"{number:g}" if number < 1e4 else f"{number:.0f}"
    spaced = f"{number:,.0f}".replace(",", " ")
    assert any(sentence.format(text) in page(name) for text in (plain, spaced))


def test_a_host_refuses_a_watchdog_and_a_rate_beyond_those_of_the_protocol():
    shortest, longest = constant(LIVE + "protocol._identity.WATCHDOG_SECONDS")  # pyright: ignore[reportGeneralTypeIssues]
    assert f"switches its cells off, {shortest:g} to {longest:g} s" in page("docs/protocol.md")


OF_USERS = {
    "jaxtwin._progress.PRINTED_AFTER": 2.0,  # performance.md: more than two seconds
    "jaxtwin._compilation._persistent_jit.MAX_PROGRAMS": 16,
    "jaxtwin.matching._descent.BATCH": 16,
    "jaxtwin.simulation._reduced_modes.MAX_RESIDUAL": 3e-4,  # K
}


@pytest.mark.parametrize("path", OF_USERS)
def test_a_number_that_other_tests_replace_is_this_for_users(path):
    assert constant(path) == OF_USERS[path]


FORMATS = {
    "jaxtwin.sweeps._plan.FORMAT": 2,
    "jaxtwin.matching._stored_fit.FORMAT": 1,
    "jaxtwin.live.protocol._messages.VERSION": 2,
}


@pytest.mark.parametrize("path", FORMATS)
def test_files_and_devices_that_there_are_carry_this_version(path):
    assert constant(path) == FORMATS[path]

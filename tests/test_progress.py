"""Which form the progress of a command has."""

import sys

import pytest

from jaxtwin.commands._show_progress import LiveProgress, PlainProgress, show_progress


@pytest.mark.parametrize(
    ("terminal", "term", "form"),
    [
        (True, "xterm-256color", LiveProgress),
        (True, "dumb", PlainProgress),
        (False, "xterm-256color", PlainProgress),
    ],
)
def test_progress_is_drawn_live_only_on_a_terminal_that_can_move_its_cursor(
    monkeypatch, terminal, term, form
):
    """On TERM=dumb rich would show nothing, and nobody would know that something goes on."""
    monkeypatch.setenv("TERM", term)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    with show_progress() as progress:
        assert type(progress) is form

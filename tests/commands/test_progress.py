"""Which form the progress of a command has, and what it says."""

import sys

import pytest

from jaxtwin import Experiment, Twin
from jaxtwin.commands._show_progress import LiveProgress, PlainProgress, show_progress
from jaxtwin.commands._validate import _ValidationProgress
from jaxtwin.matching import Iteration
from jaxtwin.validation import Prediction


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


@pytest.mark.slow
def test_a_validation_says_how_many_are_predicted_and_how_far_the_match_is():
    said: list[str] = []
    twin = Twin("single-cell")
    run = twin.simulate(Experiment.schedule("0:0.4", duration=10))
    prediction = Prediction("monday", run, twin, {}, (), None)

    class Listener:
        def step(self, text: str) -> None:
            said.append(text)

        def update(self, text: str) -> None:
            said.append(text)

    news = _ValidationProgress(Listener(), 2)
    news(prediction)
    step = Iteration(number=3, start=0, cost=0.04, rmse=0.2, gradient=0.0, accepted=True, values={})
    news(step)
    assert said == [
        "0 of 2 predicted",
        "1 of 2 predicted",
        "1 of 2 predicted, matching: iteration 3: RMSE 0.2000 K",
    ]

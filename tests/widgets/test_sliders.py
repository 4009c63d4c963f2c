"""Sliders in a notebook, as the kernel sees them: without a browser."""

import threading
from typing import Any

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin.widgets import Sliders
from jaxtwin.widgets._sliders import NewestRequest

DRIVE = jt.Experiment.schedule("0:0.5", duration=200.0, cells=2)


class Heard:
    """The messages of a widget to its views."""

    def __init__(self, widget: Any):
        self.messages: list[tuple[str, Any, list[bytes]]] = []
        self._came = threading.Condition()
        widget.send = self._take

    def _take(self, content: dict[str, Any], buffers: list[bytes]) -> None:
        with self._came:
            self.messages.append((content["kind"], content["content"], buffers))
            self._came.notify()

    def next(self, kind: str) -> tuple[Any, list[bytes]]:
        """Waits for the next message of a kind."""
        with self._came:
            assert self._came.wait_for(lambda: any(one[0] == kind for one in self.messages), 60)
            at = next(k for k, one in enumerate(self.messages) if one[0] == kind)
            return self.messages.pop(at)[1:]


@pytest.fixture
def twin() -> jt.Twin:
    return jt.Twin("paper-2024")


def test_a_view_gets_the_run_of_the_twin_and_the_recording(twin: jt.Twin) -> None:
    recording = jt.simulate(twin.with_values({"R_pc": 0.2}), DRIVE).to_recording(seed=1)
    sliders = Sliders(twin, recording)
    heard = Heard(sliders)
    sliders.on_request({"kind": "hello"})
    shown, _ = heard.next("recording")
    assert recording.temperatures is not None
    np.testing.assert_allclose(np.transpose(shown["measured"]), recording.temperatures, atol=6e-4)
    said, (channels, duty, elements) = heard.next("run")
    run = jt.simulate(twin, recording)
    count = said["samples"]
    assert count == len(recording.time)
    assert said["rmse"] == pytest.approx(run.rmse)
    np.testing.assert_allclose(floats(channels, count, -1), run.temperatures, atol=1e-4)
    np.testing.assert_allclose(floats(duty, count, -1), recording.duty)
    sent = np.frombuffer(elements, np.float32).reshape(count, -1)
    np.testing.assert_allclose(sent, run.states[:, : run.elements], atol=1e-4)
    sliders.close()


def test_a_value_that_is_set_is_simulated_and_is_that_of_the_twin(twin: jt.Twin) -> None:
    sliders = Sliders(twin, DRIVE, ["R_pc", "T_amb"])
    heard = Heard(sliders)
    sliders.values = {**sliders.values, "R_pc": 0.2}
    said, (channels, *_) = heard.next("run")
    run = jt.simulate(twin.with_values({"R_pc": 0.2}), DRIVE)
    np.testing.assert_allclose(floats(channels, said["samples"], -1), run.temperatures, atol=1e-4)
    assert said["rmse"] is None
    assert float(sliders.twin.values["R_pc"]) == 0.2
    sliders.values = {"T_amb": 17.0}  # the others stay
    assert sliders.values == {"R_pc": 0.2, "T_amb": 17.0}
    sliders.close()


def test_without_an_experiment_each_heater_has_a_slider_for_its_duty() -> None:
    sliders = Sliders(jt.Twin("tclab"), duration=100)
    heard = Heard(sliders)
    assert sliders.duty == [0.5, 0.5]
    sliders.duty = [1.0, 0.0]
    said, (channels, duty, _) = heard.next("run")
    np.testing.assert_array_equal(floats(duty, said["samples"], 2), [[1, 0]] * said["samples"])
    first, second = floats(channels, said["samples"], 2)[-1]
    assert first > second
    sliders.close()


def test_a_slider_stays_within_the_bounds_of_the_rig_file(twin: jt.Twin) -> None:
    for one in Sliders(twin, DRIVE).about["parameters"]:
        parameter = twin.rig.parameters[one["name"]]
        ends = [parameter.from_entry(one[end]) for end in ("low", "high")]
        assert parameter.lower * (1 - 1e-12) <= ends[0] <= one["value"] <= ends[1]
        assert ends[1] <= parameter.upper * (1 + 1e-12)


def test_unknown_names_are_refused(twin: jt.Twin) -> None:
    with pytest.raises(jt.errors.ParameterError, match=r"paper-2024: .*'R_p'.*R_pc"):
        Sliders(twin, DRIVE, ["R_p"])
    sliders = Sliders(twin, DRIVE, ["R_pc"])
    with pytest.raises(jt.errors.ParameterError, match="nonsense"):
        sliders.values = {"nonsense": 1.0}
    assert list(sliders.values) == ["R_pc"]
    sliders.close()


def test_what_cannot_be_simulated_is_said_to_the_views(twin: jt.Twin) -> None:
    sliders = Sliders(twin, DRIVE, ["R_pc"])
    heard = Heard(sliders)
    sliders.values = {"R_pc": -1.0}
    problem, _ = heard.next("problem")
    assert "R_pc" in problem
    sliders.close()


def test_only_the_newest_of_waiting_requests_is_answered() -> None:
    begun, go_on, done = threading.Event(), threading.Event(), threading.Event()
    answered = []

    def answer(request: int) -> None:
        answered.append(request)
        begun.set()
        go_on.wait(10)
        if request == 9:
            done.set()

    newest = NewestRequest(answer)
    newest.ask(0)
    assert begun.wait(10)
    for request in range(1, 10):
        newest.ask(request)
    go_on.set()
    assert done.wait(10)
    assert answered == [0, 9]
    newest.close()


def floats(buffer: bytes, samples: int, rows: int) -> np.ndarray:
    """A table of rows of samples, with an axis for the samples first."""
    return np.frombuffer(buffer, np.float32).reshape(rows, samples).T

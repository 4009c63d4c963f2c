"""A controller of a user: in one class and one line, it has a file and C, and is checked for
stability."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiled_c import compiled, ran

from jaxtwin import Twin, simulate_closed_loop
from jaxtwin.c_export import export_c
from jaxtwin.control import (
    PID,
    ControllerField,
    Law,
    read_controller,
    register_controller,
    save_controller,
)
from jaxtwin.control.controllers._controller import (
    AbstractChannelGroupController,
    AbstractController,
)
from jaxtwin.control.loops._loop_margins import check_stability
from jaxtwin.errors import ControlError

LAW = """
static void model_law_init(model_state *state, const model_real *duty,
                           const model_real *measurement)
{
    int i;
    (void)measurement;
    for (i = 0; i < MODEL_CELLS; ++i) {
        state->integral[i] = duty[i];
    }
}

static void model_law(model_state *state, const model_real *reference, int samples,
                      model_real *duty)
{
    int i;
    (void)samples;
    for (i = 0; i < MODEL_CELLS; ++i) {
        const model_real proportional = model_gain[i] * (reference[0] - state->seen[0]);
        duty[i] = model_limited(i, proportional + state->integral[i]);
        model_integrate(state, i, model_share[i] * (duty[i] - state->integral[i]));
    }
}
"""


@register_controller
class AutomaticReset(AbstractChannelGroupController):
    """A PI controller whose integral part follows the limited duty with a time constant."""

    kind: ClassVar[str] = "own-reset"
    fields: ClassVar[Mapping[str, ControllerField]] = {
        "gain": ControllerField("a gain", "1/K", "0.1 1/K", is_required=True),
        "reset_time": ControllerField("a time", "s", "100 s", is_required=True),
    }

    gain: np.ndarray
    reset_time_s: np.ndarray
    sample_time_s: float = eqx.field(static=True)
    limits: tuple[float, float] = eqx.field(static=True)
    measured: Any = eqx.field(static=True)

    def __init__(
        self,
        gain: Any,
        reset_time_s: Any,
        sample_time_s: float = 1.0,
        limits: Sequence[float] = (0.0, 1.0),
        measured: Any = None,
    ):
        self.gain, self.reset_time_s = np.asarray(gain, float), np.asarray(reset_time_s, float)
        self.sample_time_s, self.limits = sample_time_s, (float(limits[0]), float(limits[1]))
        self.measured = measured and tuple(
            (g,) if isinstance(g, str) else tuple(g) for g in measured
        )

    @property
    def is_linear(self) -> bool:
        return True

    @classmethod
    def fits_outputs(cls, outputs: int, cells: int) -> bool:
        return outputs == 1

    def law(self, cells: int) -> Law:
        gain = np.broadcast_to(self.gain, (cells,))
        share = np.broadcast_to(self.sample_time_s / self.reset_time_s, (cells,))
        tables = {"gain": (gain, "1/K"), "share": (share, "sample time / reset time")}
        return Law(LAW, "a PI by automatic reset", tables, integrals=cells)

    def init(self, duty: Any, measurement: Any) -> Any:
        return jnp.asarray(duty)

    def step(self, state: Any, reference: Any, measurement: Any) -> Any:
        asked = state + self.gain * (jnp.asarray(reference) - jnp.asarray(measurement))
        duty = jnp.clip(asked, *self.limits)
        return duty, state + self.sample_time_s / self.reset_time_s * (duty - state)


def test_what_is_saved_is_read_again(tmp_path: Path, twin: Twin):
    controller = AutomaticReset([0.1, 0.05], 80.0, 0.5, measured=(("T11", "T16"),))
    path = tmp_path / "own.toml"
    save_controller(path, controller, twin.rig)
    assert 'kind = "own-reset"' in path.read_text()
    assert 'gain = ["0.1 1/K", "0.05 1/K"]' in path.read_text()
    again = read_controller(path, twin.rig)
    assert isinstance(again, AutomaticReset)
    np.testing.assert_array_equal(again.gain, [0.1, 0.05])
    assert (float(again.reset_time_s), again.sample_time_s) == (80.0, 0.5)
    assert repr(again) == repr(controller)
    assert "gain=[0.1, 0.05] 1/K" in repr(controller)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("gain =", "gains =", "gains: unknown field 'gains'"),
        ('"80.0 s"', '"80 K"', "reset_time: expected a time above 0"),
        ('"80.0 s"', '["8 s", "9 s", "9 s"]', "reset_time: expected one value, or one for each"),
        ('[["T11", "T16"]]', '["T11", "T16"]', "measured: expected an output for each of the 2"),
        (
            "own-reset",
            "own-rest",
            "did you mean 'own-reset'",
        ),
    ],
)
def test_a_wrong_field_of_an_own_controller_is_named(
    tmp_path: Path, twin: Twin, old: str, new: str, message: str
):
    path = tmp_path / "own.toml"
    save_controller(path, AutomaticReset(0.1, 80.0, measured=(("T11", "T16"),)), twin.rig)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ControlError, match=message):
        read_controller(path, twin.rig)


@pytest.mark.slow
def test_a_loop_that_is_not_stable_is_refused(twin: Twin):
    """The same margin as that of the proportional part of a PID."""
    weights = np.full((1, len(twin.channels)), 1 / len(twin.channels))
    reference = np.array([[40.0]])
    check_stability(twin, AutomaticReset(0.3, 1e4), weights, reference)
    with pytest.raises(ControlError, match="grow e-fold in"):
        check_stability(twin, AutomaticReset(0.5, 1e4), weights, reference)


def test_an_own_controller_holds_its_reference_on_a_twin(twin: Twin):
    run = simulate_closed_loop(twin, AutomaticReset(0.1, 80.0), 35, duration=900, noise=False)
    np.testing.assert_allclose(run.measurement[-1], 35, atol=0.1)


MAIN = """
#include <stdio.h>
#include "reset.h"

int main(void)
{
    static reset_state state;
    static reset_real duty[RESET_CELLS], row[2];
    double reference, measurement;
    int begun = 0;
    while (scanf("%lf %lf", &reference, &measurement) == 2) {
        row[0] = (reset_real)reference;
        row[1] = (reset_real)measurement;
        if (!begun) {
            reset_init(&state, duty, row + 1);
            begun = 1;
        }
        reset_step(&state, row, row + 1, duty);
        printf("%.17g %.17g\\n", (double)duty[0], (double)duty[1]);
    }
    return 0;
}
"""


@pytest.mark.c_compiler
@pytest.mark.parametrize(("precision", "allowed"), [("double", 1e-13), ("float", 1e-6)])
def test_the_c_of_an_own_controller_commands_the_duty_of_python(
    tmp_path: Path, twin: Twin, precision: Any, allowed: float
):
    controller = AutomaticReset([0.1, 0.05], 80.0)
    sources = export_c(controller, tmp_path, rig=twin.rig, name="reset", precision=precision)
    assert "a PI by automatic reset for the rig dual-cell" in sources.header.read_text()
    random = np.random.default_rng(0)
    rows = np.column_stack([np.full(300, 35.0), 34.0 + 3 * random.normal(size=300)]).round(3)
    expected = []
    with jax.enable_x64(True):
        state = controller.init(np.zeros(2), rows[0, 1:])
        for reference, measurement in rows:
            duty, state = controller.step(state, reference[None], measurement[None])
            expected.append(np.asarray(duty))
    found = ran(compiled(sources, MAIN), rows)
    np.testing.assert_allclose(found, expected, rtol=0, atol=allowed)
    assert (found.min(), found.max()) == (0.0, 1.0)  # both limits are reached


def test_a_class_that_does_not_say_whether_it_is_linear_makes_no_controller():
    class Silent(AbstractChannelGroupController):
        sample_time_s: float = 1.0
        limits: tuple[float, float] = (0.0, 1.0)
        measured: Any = None

        def init(self, duty: Any, measurement: Any) -> Any:
            return ()

        def step(self, state: Any, reference: Any, measurement: Any) -> Any:
            return jnp.zeros(2), state

    with pytest.raises(TypeError, match="is_linear"):
        Silent()  # pyright: ignore[reportAbstractUsage]


def test_what_cannot_be_registered_is_refused():
    class Nameless(AbstractController):
        pass

    class Misspelt(AbstractController):
        kind: ClassVar[str] = "misspelt"
        fields: ClassVar[Mapping[str, ControllerField]] = {"gian": ControllerField("a gain", "1/K")}
        gain: float = 0.1

    class Taken(AbstractController):
        kind: ClassVar[str] = "pid"

    with pytest.raises(ControlError, match=r"Nameless\.kind: expected its name in files"):
        register_controller(Nameless)
    with pytest.raises(ControlError, match=r"Misspelt\.fields: expected names .* got 'gian'"):
        register_controller(Misspelt)
    with pytest.raises(ControlError, match=r"a name that is not taken, got 'pid' of PID"):
        register_controller(Taken)
    instance: Any = PID(0.1)
    with pytest.raises(ControlError, match="expected a class of controllers, got PID"):
        register_controller(instance)

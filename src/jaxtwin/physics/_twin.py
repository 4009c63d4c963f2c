"""The twin: a rig with values for its parameters."""

import difflib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._arguments import mapping_of, of_kind
from .._celsius import ZERO_CELSIUS
from .._name_suggestions import did_you_mean, unknown_name
from .._pint_quantities import in_unit
from .._twin_address import twin_address
from ..errors import JaxtwinError, ParameterError, SimulationError
from ..rig import Parameter, Rig, load_rig, read_parameters
from ..rig._build import rig_of_stored_twin
from ..rig._units import Kind, parse_quantity
from ._netlist import Netlist
from ._placed import all_values
from ._system import System
from ._thermoelectric import ThermoelectricModule
from ._wiring import Wiring, wiring_of

if TYPE_CHECKING:
    import diffrax

    from ..io import Experiment
    from ..simulation import Initial, Run


@final
class Twin(eqx.Module):
    """A rig that can be run, differentiable in every parameter.

    A twin is a PyTree whose leaves are its parameter values: it can be passed through `jax.jit`,
    `jax.vmap` and `jax.grad`. New values need no new compilation.

    **Arguments:**

    - `rig`: a `Rig`, or the argument of `load_rig`; or the address of a twin in a store, such as
      `twins.db@champion`, which has the rig and its values.
    - `values`: values that replace those of the rig's table, name -> value in the table's unit;
      one of `rig.parameter_sets`, for example. Or the path of a parameter file, such as a saved
      fit, or an address in a store; it is read by `read_parameters`.

    **Raises:** `ParameterError` for a name that the rig does not have, a value that is no number,
    or a file that cannot be read or is of another rig.
    """

    values: dict[str, Float[Array | np.ndarray, "*draws"]]
    rig: Rig = eqx.field(static=True)

    def __init__(
        self,
        rig: Rig | str | os.PathLike[str],
        values: Mapping[str, Any] | str | os.PathLike[str] | None = None,
    ):
        address = twin_address(rig)
        if address is not None:
            self.rig = rig_of_stored_twin(address)
            values = f"{address.file}@{address.name}" if values is None else values
        else:
            self.rig = load_rig(rig)
        table = {name: np.asarray(row.value) for name, row in self.rig.parameters.items()}
        self.values = _replaced(self.rig, table, _from_file(self.rig, values))

    def with_values(
        self, values: Mapping[str, Any] | str | os.PathLike[str] | None = None, **named: Any
    ) -> "Twin":
        """Returns the twin with other values: name -> value in the unit of the rig's table, or
        those of a parameter file.

        **Raises:** `ParameterError` as above.
        """
        if values is None or named:
            given = ", ".join(f"{name!r}: {value}" for name, value in named.items())
            raise ParameterError(
                "with_values: expected one mapping, because a parameter may have any name: "
                f"with_values({{{given or 'name: value'}}})"
            )
        replaced = _replaced(self.rig, self.values, _from_file(self.rig, values))
        return eqx.tree_at(lambda twin: twin.values, self, replaced)

    def __getitem__(self, name: str) -> Any:
        """The value of a parameter, in the unit of the rig's table.

        **Raises:** `ParameterError` for an unknown name.
        """
        if name not in self.values:
            known = self.rig.parameters
            raise ParameterError(f"{self.rig.name}: {unknown_name('parameter', name, known)}")
        return self.values[name]

    @property
    def wiring(self) -> Wiring:
        """The constant structure of the rig's equations."""
        return wiring_of(self.rig)

    @property
    def netlist(self) -> Netlist:
        """Nodes, links and cells."""
        return self.wiring.netlist

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels."""
        return self.wiring.channels

    @property
    def values_si(self) -> dict[str, Float[Array, "*draws"]]:
        """All values in SI units, the inputs where none is stated, and what follows from places on
        the plate."""
        table = self.rig.parameters
        values = {name: table[name].to_si(jnp.asarray(v)) for name, v in self.values.items()}
        return {name: jnp.asarray(v) for name, v in all_values(self.rig, values).items()}

    @property
    def numbers_si(self) -> dict[str, float]:
        """The `values_si` as plain numbers.

        **Raises:** `ParameterError` if a parameter holds more than one value.
        """
        numbers = {}
        for name, value in self.values.items():
            if np.ndim(value) > 0:
                count, array = np.size(value), " in an array" if np.size(value) == 1 else ""
                raise ParameterError(
                    f"{self.rig.name}: parameter {name}: expected one value, got {count}{array}; "
                    "pass several to simulate_batch"
                )
            numbers[name] = float(self.rig.parameters[name].to_si(np.float64(value)))
        return {name: float(v) for name, v in all_values(self.rig, numbers).items()}

    def system(self, *, lumped: bool = False) -> System:
        """The equations with these values in them; a pure function of the parameters.

        **Arguments:**

        - `lumped`: whether nodes that are always equal, such as mirror images on a symmetric plate,
          are combined. `system.wiring.position` is then the position of the node that represents
          each of them.
        """
        return System.assemble(wiring_of(self.rig, lumped), self.values_si)

    def module(self, cell: str) -> ThermoelectricModule:
        """The thermoelectric module of a cell, for example for a DC sweep.

        **Raises:** `ParameterError` if the rig has no such cell, or a parameter holds more than
        one value.
        """
        for element in self.netlist.cells:
            if element.name == cell and element.thermal_resistance is not None:
                values = self.numbers_si
                return ThermoelectricModule(
                    float(element.seebeck_coefficient.evaluate(values)),
                    float(element.electrical_resistance.evaluate(values)),
                    float(element.thermal_resistance.evaluate(values)),
                )
        names = [element.name for element in self.netlist.cells if not element.is_heater]
        raise ParameterError(
            f"{self.rig.name}: expected one of the cells {', '.join(names) or '(none)'}, got "
            f"{cell!r}"
            f"{did_you_mean([str(cell)], names)}"
        )

    def simulate(
        self,
        experiment: "Experiment | str",
        *,
        duration: float | int | None = None,
        initial: "Initial" = None,
        solver: "diffrax.AbstractSolver | None" = None,
        stepsize_controller: "diffrax.AbstractStepSizeController | None" = None,
        dt0: float | None = None,
    ) -> "Run":
        """Runs the twin through an experiment: `jaxtwin.simulate(self, experiment, ...)`.

        **Arguments:**

        - `experiment`: an experiment, or a duty schedule in words such as `"0:0.5,500:0.78"`: see
          `Experiment.schedule`.
        - `duration`: the duration of that schedule, s.
        - `initial`, `solver`, `stepsize_controller`, `dt0`: those of `jaxtwin.simulate`.

        **Raises:** `SimulationError` for a schedule without a duration, or a duration beside an
        experiment; the errors of `Experiment.schedule` and `jaxtwin.simulate`.
        """
        # A twin does not depend on solvers; this method is a convenience at a prompt.
        from ..io import Experiment
        from ..simulation import simulate

        if isinstance(experiment, str):
            if duration is None:
                raise SimulationError(
                    f"{self.rig.name}: simulate: expected a duration beside the schedule "
                    f"{experiment!r}, got none; call simulate({experiment!r}, duration=600.0), in "
                    "s"
                )
            cells = len(self.netlist.cells)
            experiment = Experiment.schedule(experiment, duration=duration, cells=cells)
        elif duration is not None:
            raise SimulationError(
                f"{self.rig.name}: simulate: expected a duration only beside a schedule in words, "
                f"got {duration!r} beside an experiment; shorten the experiment with "
                "Experiment.between"
            )
        return simulate(
            self,
            experiment,
            initial=initial,
            solver=solver,
            stepsize_controller=stepsize_controller,
            dt0=dt0,
        )

    def __repr__(self) -> str:
        return f"<Twin of {self.rig.name}: {len(self.values)} parameters>"


def _from_file(
    rig: Rig, values: Mapping[str, Any] | str | os.PathLike[str] | None
) -> Mapping[str, Any] | None:
    if not isinstance(values, str | os.PathLike):
        return values
    is_file = str(values).endswith(".toml") or Path(values).exists()
    if isinstance(values, str) and not is_file and twin_address(values) is None:
        near = difflib.get_close_matches(values, rig.parameter_sets, n=1)
        hint = f"; did you mean rig.parameter_sets[{near[0]!r}]?" if near else ""
        raise ParameterError(
            f"{rig.name}: values: expected name -> value or the path of a parameter file, got "
            f"{values!r}, and there is no such file{hint} Parameter sets of the rig: "
            f"{', '.join(rig.parameter_sets) or 'none'}"
        )
    return read_parameters(values, rig)


def check_twin(where: str, twin: object, error: type[JaxtwinError]) -> None:
    """Refuses an argument that is not a twin, such as a rig or the name of a rig.

    **Raises:** `error`.
    """
    of_kind(where, twin, Twin, "a Twin, as Twin(rig) makes it", error)


def _replaced(
    rig: Rig, values: dict[str, Any], changes: Mapping[str, Any] | None
) -> dict[str, Any]:
    replaced = dict(values)
    changes = {} if changes is None else changes
    mapping_of(f"{rig.name}: values", changes, "name -> value", ParameterError)
    for name, value in changes.items():
        if name not in rig.parameters:
            raise ParameterError(f"{rig.name}: {unknown_name('parameter', name, rig.parameters)}")
        replaced[name] = _checked(rig, name, value)
    return replaced


def _checked(rig: Rig, name: str, value: object) -> Any:
    if isinstance(value, Tracer):  # has no number to look at yet
        return value
    parameter = rig.parameters[name]
    where = f"{rig.name}: parameter {name}"
    value = in_unit(where, value, parameter.unit, ParameterError)
    if isinstance(value, str):
        value = parameter.from_si(_quantity(where, value, parameter.unit))
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        array = np.array(None)
    if array.dtype.kind not in "fiu" or array.size == 0 or not np.isfinite(array).all():
        raise ParameterError(
            f"{where}: expected finite numbers, got {value!r}; they are in "
            f"{parameter.unit or 'no unit'}"
        )
    _check_not_kelvin(where, parameter, array)
    return value if isinstance(value, jax.Array) else array.astype(float)


def _quantity(where: str, text: str, unit: str) -> float:
    """A text with a unit, such as "2 ohm", in SI units."""
    kind = Kind(f"the same as {unit!r}", unit, f"1 {unit}", absolute=unit == "degC")
    try:
        return parse_quantity(text, kind)
    except ValueError as problem:
        raise ParameterError(
            f"{where}: expected finite numbers, got {text!r}, {problem}; they are in "
            f'{unit or "no unit"}, or text such as "1 {unit}"'
        ) from None


def _check_not_kelvin(where: str, parameter: Parameter, values: np.ndarray) -> None:
    """Refuses temperatures outside their bounds that are inside them if they are taken for kelvin.

    **Raises:** `ParameterError` with the value in both units.
    """
    if parameter.unit != "degC":
        return
    outside = (values < parameter.lower) | (values > parameter.upper)
    celsius = values - ZERO_CELSIUS
    kelvin = outside & (celsius >= parameter.lower) & (celsius <= parameter.upper)
    if kelvin.any():
        value = values[kelvin].flat[0]
        raise ParameterError(
            f"{where}: expected {parameter.lower:g} to {parameter.upper:g} degC, got {value:g}; in "
            f'K, that is {value - ZERO_CELSIUS:g} degC: write "{value:g} K"'
        )

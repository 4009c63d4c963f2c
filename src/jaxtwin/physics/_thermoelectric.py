r"""The thermoelectric module, eqs. (7)-(10) of the paper.

The signs are those of the authors' circuit: the current $I$ is positive when it pumps heat out of
the cold side.

$$EMF = \alpha (T_h - T_c), \quad
q_c = \alpha I T_c - \tfrac12 R_E I^2, \quad
q_h = \alpha I T_h + \tfrac12 R_E I^2$$

$q_c$ leaves the cold side, $q_h$ enters the hot side, and $q_h - q_c = I V$ with
$V = EMF + R_E I$.
Heat also flows back through the module's thermal resistance $R_{Th}$; in a twin that is a link of
the network, and only the DC sweep adds it here.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, ArrayLike, Float

from .._display import picture
from .._jax_settings import own_settings
from .._result import AbstractResult, dataset, table
from ..errors import ParameterError
from ..rig import load_module

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@final
@dataclass(frozen=True, repr=False)
class DCSweep(AbstractResult):
    """Curves over the current, one for each temperature difference, Fig. 11 of the paper.

    **Arguments:**

    - `current`: `(currents,)`, A.
    - `delta_T`: hot - cold, `(differences,)`, K.
    - `T_hot`: the temperature of the hot side, K.
    - `heat_flow`: $Q_c$, the heat absorbed at the cold side minus the heat conducted back,
      `(differences, currents)`, W.
    - `power`: the electrical power, `(differences, currents)`, W.
    """

    current: Float[np.ndarray, " currents"]
    delta_T: Float[np.ndarray, " differences"]  # noqa: N815  # the symbol of datasheets
    T_hot: float
    heat_flow: Float[np.ndarray, "differences currents"]
    power: Float[np.ndarray, "differences currents"]

    @property
    def cop(self) -> Float[np.ndarray, "differences currents"]:
        """Coefficient of performance $Q_c / P$; NaN where the power is not above 0."""
        power = np.where(self.power > 0, self.power, np.nan)
        return self.heat_flow / power

    def plot(self) -> "Figure":
        """Plots the curves over the current: `jaxtwin.plots.plot_dc_curves`."""
        return picture("plot_dc_curves", self)

    def __repr__(self) -> str:
        low, high = self.current.min(), self.current.max()
        return (
            f"<DCSweep at T_hot = {self.T_hot:g} K: {len(self.current)} currents, {low:g} to "
            f"{high:g} A, at {len(self.delta_T)} differences>"
        )

    def _overview(self) -> "pandas.DataFrame":
        most, at = self.heat_flow.max(axis=1), self.current[self.heat_flow.argmax(axis=1)]
        return table({"delta_T, K": self.delta_T, "most heat, W": most, "at, A": at})

    def to_xarray(self) -> "xarray.Dataset":
        """Returns the curves as a dataset with dimensions (delta_T, current) and units in the
        attributes."""
        curves = "delta_T current"
        return dataset(
            {
                "heat_flow": (curves, self.heat_flow, "W"),
                "power": (curves, self.power, "W"),
                "cop": (curves, self.cop, "1"),
                "delta_T": ("delta_T", self.delta_T, "K"),
                "current": ("current", self.current, "A"),
            },
            {"T_hot_K": self.T_hot},
        )


@final
class ThermoelectricModule(eqx.Module):
    """A thermoelectric (Peltier) module.

    **Arguments:**

    - `seebeck_coefficient`: the Seebeck coefficient of the whole module, V/K.
    - `electrical_resistance`: the electrical resistance of the whole module, ohm.
    - `thermal_resistance`: the thermal resistance between the two sides, K/W.
    """

    seebeck_coefficient: Float[ArrayLike, "*cells"]
    electrical_resistance: Float[ArrayLike, "*cells"]
    thermal_resistance: Float[ArrayLike, "*cells"]

    @classmethod
    def from_datasheet(
        cls,
        name: str | None = None,
        *,
        maximum_voltage: float | int | None = None,
        maximum_current: float | int | None = None,
        maximum_temperature_difference: float | int | None = None,
        hot_side_temperature: float | int | None = None,
    ) -> "ThermoelectricModule":
        r"""A module from its datasheet, eq. (10) of the paper:

        $$\alpha = \frac{V_{max}}{T_h}, \quad
        R_E = \frac{V_{max}}{I_{max}} \frac{T_h - \Delta T_{max}}{T_h}$$

        $$R_{Th} = \frac{\Delta T_{max}}{I_{max} V_{max}} \frac{2 T_h}{T_h - \Delta T_{max}}$$

        **Arguments:**

        - `name`: a bundled datasheet such as `"TEC1-12706"`; None if the following arguments state
          all numbers.
        - `maximum_voltage` (V), `maximum_current` (A), `maximum_temperature_difference` (K) at
          `hot_side_temperature` (K): $V_{max}$, $I_{max}$, $\Delta T_{max}$, $T_h$. If a name is
          given too, they replace the numbers of its datasheet.

        **Raises:** `RigError` if no datasheet has this name; `ParameterError` if a number is
        missing, not above 0, or the difference is not below the hot side temperature.
        """
        given = {
            "maximum_voltage": maximum_voltage,
            "maximum_current": maximum_current,
            "maximum_temperature_difference": maximum_temperature_difference,
            "hot_side_temperature": hot_side_temperature,
        }
        sheet = load_module(name) if name is not None else None
        numbers = {
            field: getattr(sheet, field) if value is None and sheet is not None else value
            for field, value in given.items()
        }
        V_max, I_max, dT_max, T_h = (_above_zero(field, n) for field, n in numbers.items())
        if dT_max >= T_h:
            raise ParameterError(
                "maximum_temperature_difference: expected a value below the hot_side_temperature "
                f"of {T_h} K, got {dT_max} K"
            )
        return cls(
            seebeck_coefficient=V_max / T_h,
            electrical_resistance=V_max / I_max * (T_h - dT_max) / T_h,
            thermal_resistance=dT_max / (I_max * V_max) * 2 * T_h / (T_h - dT_max),
        )

    def heat_flows(
        self,
        current: Float[ArrayLike, "*shape"],
        cold_temperature: Float[ArrayLike, "*shape"],
        hot_temperature: Float[ArrayLike, "*shape"],
    ) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
        """Peltier and Joule heat, eqs. (8) and (9).

        **Arguments:**

        - `current`: A.
        - `cold_temperature`, `hot_temperature`: absolute, K.

        **Returns:** $q_c$ out of the cold side and $q_h$ into the hot side, W.
        """
        I = jnp.asarray(current)  # noqa: E741
        return self.mean_heat_flows(I, I**2, cold_temperature, hot_temperature)

    def mean_heat_flows(
        self,
        current: Float[ArrayLike, "*shape"],
        squared_current: Float[ArrayLike, "*shape"],
        cold_temperature: Float[ArrayLike, "*shape"],
        hot_temperature: Float[ArrayLike, "*shape"],
    ) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
        """Computes the mean `heat_flows` of a current that changes faster than temperatures do.

        **Arguments:** those of `heat_flows`, with the means of the current, A, which carries the
        Peltier heat, and of its square, A^2, which makes the Joule heat.
        """
        peltier = jnp.asarray(self.seebeck_coefficient) * jnp.asarray(current)
        half_joule = 0.5 * jnp.asarray(self.electrical_resistance) * jnp.asarray(squared_current)
        return peltier * cold_temperature - half_joule, peltier * hot_temperature + half_joule

    def emf(self, temperature_difference: Float[ArrayLike, "*shape"]) -> Float[Array, "*shape"]:
        """Electromotive force for a difference hot - cold, eq. (7), V."""
        return jnp.asarray(self.seebeck_coefficient) * jnp.asarray(temperature_difference)

    def optimum_current(self, cold_temperature: float) -> float:
        r"""The current of the largest heat flow at a given difference, $\alpha T_c / R_E$, A."""
        alpha, R_E, _ = self._constants
        return alpha * cold_temperature / R_E

    def maximum_temperature_difference(self, cold_temperature: float) -> float:
        r"""The difference at which no heat can be pumped any more, K.

        $\tfrac12 Z T_c^2$ with the figure of merit $Z = \alpha^2 R_{Th} / R_E$.
        """
        alpha, R_E, R_Th = self._constants
        return 0.5 * alpha**2 * R_Th / R_E * cold_temperature**2

    @property
    def _constants(self) -> tuple[float, float, float]:
        """The constants of a single module as plain numbers."""
        values = (self.seebeck_coefficient, self.electrical_resistance, self.thermal_resistance)
        alpha, R_E, R_Th = (np.asarray(value, float).item() for value in values)
        return alpha, R_E, R_Th

    def dc_sweep(
        self,
        currents: npt.ArrayLike,
        delta_T: npt.ArrayLike,
        T_hot: float | int,
    ) -> DCSweep:
        """Heat flow and coefficient of performance over the current, Fig. 11 of the paper.

        **Arguments:**

        - `currents`: `(currents,)`, A.
        - `delta_T`: `(differences,)`, hot - cold, one curve each, K.
        - `T_hot`: hot side temperature, K; the cold side is at `T_hot - delta_T`.

        **Returns:** a `DCSweep`.

        **Raises:** `ParameterError` if a difference is not below `T_hot` or a number is not
        finite.
        """
        I = np.ravel(np.asarray(currents, float))  # noqa: E741
        dT = np.ravel(np.asarray(delta_T, float))
        if not np.isfinite([*I, *dT, T_hot]).all() or (dT >= T_hot).any():
            raise ParameterError(
                "dc_sweep: expected finite numbers and differences below T_hot, got T_hot = "
                f"{T_hot} K, differences {dT} K and currents {I} A"
            )
        with own_settings():
            cold = jnp.broadcast_to(T_hot - dT[:, None], (dT.size, I.size))
            q_c, q_h = self.heat_flows(I[None, :] + 0 * cold, cold, jnp.full_like(cold, T_hot))
            pumped = np.asarray(q_c - dT[:, None] / self._constants[2])
            power = np.asarray(q_h - q_c)
        return DCSweep(current=I, delta_T=dT, T_hot=float(T_hot), heat_flow=pumped, power=power)


def _above_zero(field: str, value: float | int | None) -> float:
    if value is None or not 0 < value < np.inf:
        raise ParameterError(f"{field}: expected a number above 0, got {value}")
    return float(value)

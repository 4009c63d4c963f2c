"""PWM and H-bridge: the current and heat flows of a cell at a given duty cycle."""

from typing import Literal, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ._netlist import OWN_VOLTAGE
from ._thermoelectric import ThermoelectricModule


class CellHeat(NamedTuple):
    """Mean heat flows and power of the cells over a PWM period, each `(cells,)`, or
    numbers for one cell.

    - `cold`: $q_c$ out of the cold (plate) side, W.
    - `hot`: $q_h$ into the hot (far) side, W.
    - `current`: mean current, A.
    - `power`: mean electrical power taken up between the terminals, $q_h - q_c$, W.
    """

    cold: Float[Array, "*cells"]
    hot: Float[Array, "*cells"]
    current: Float[Array, "*cells"]
    power: Float[Array, "*cells"]


# The duty below which the heat of a heater is proportional to it: a fractional power has no
# derivative at zero. Full duty is not changed, and a quadratic law by 5e-9 of the power.
DUTY_SMOOTHING = 1e-4


def share_of_duty(
    duty: Float[Array, "*cells"], exponent: Float[Array, "*#cells"]
) -> Float[Array, "*cells"]:
    r"""The share of its power that a heater gives at a duty.

    $d \left(\frac{d^2 + s^2}{1 + s^2}\right)^{(p - 1) / 2}$ with $s$ = `DUTY_SMOOTHING`, which is
    $d^p$ but for the smallest duties. C and SPICE are written from this function
    (`_make_laws.py`).
    """
    square = (duty**2 + DUTY_SMOOTHING**2) / (1 + DUTY_SMOOTHING**2)
    return duty * jnp.exp((exponent - 1) / 2 * jnp.log(square))


@final
class Bridge(eqx.Module):
    r"""An H-bridge between a supply and each cell.

    Positive duty $d$ heats the plate, so the terminal voltage is $-d V_s$ (the plate is at the
    cold port and is heated by a reversed current).

    `averaging = "voltage"` puts the mean voltage on the cell:
    $I (R_E + R_{on} + |d| R_s) = -d V_s - \alpha (T_h - T_c)$.

    `averaging = "on-off"` follows the two parts of a PWM period, during which temperatures are
    constant, and averages current and Joule heat. For the fraction $|d|$ the cell is connected,
    $I (R_E + R_{on} + R_s) = \mp V_s - \alpha (T_h - T_c)$; for the rest of the period it is
    shorted by the bridge, $I (R_E + R_{on}) = - \alpha (T_h - T_c)$, or open, $I = 0$. The two
    differ: at half duty the mean voltage causes a quarter of the full Joule heat, and on/off
    switching half of it.

    A controller with a current limit $I_{max}$ lowers the voltage until no more than $I_{max}$
    flows, in either direction. With on/off switching it does so while the cell is connected,
    because it cannot limit the current through a shorted cell; with the mean voltage it does so
    always.

    **Arguments:**

    - `supply_voltage`: $V_s$, V.
    - `supply_resistance`: $R_s$ of supply and leads, in series while a cell is connected, ohm.
    - `on_resistance`: $R_{on}$, ohm.
    - `current_limit`: $I_{max}$, A; None for no limit.
    - `heaters`: for each cell whether it is a heater, whose duty is 0 to 1; empty if none is.
    - `own_supply`: for each cell whether it is a heater of a given power, which a supply of its own
      without a resistance feeds, switched on and off whatever the averaging; empty if none is.
    - `own_voltage`: the voltage of these supplies, V.
    - `supply_share`: the share of the supply's voltage that reaches each bridge; None for all of
      it, as in a rig without a fault.
    - `drive_exponent`: the exponent of the duty to which the heat of each heater of a given power
      is proportional, see `share_of_duty`; None if all are 1.
    """

    supply_voltage: Float[ArrayLike, ""]
    supply_resistance: Float[ArrayLike, ""]
    on_resistance: Float[ArrayLike, ""]
    averaging: Literal["voltage", "on-off"] = eqx.field(static=True)
    off_phase: Literal["brake", "open"] = eqx.field(static=True)
    current_limit: Float[ArrayLike, ""] | None = None
    heaters: tuple[bool, ...] = eqx.field(static=True, default=())
    own_supply: tuple[bool, ...] = eqx.field(static=True, default=())
    own_voltage: Float[ArrayLike, ""] = OWN_VOLTAGE.factor
    supply_share: Float[Array, " cells"] | None = None
    drive_exponent: Float[Array, "*cells"] | None = None

    def heat(
        self,
        module: ThermoelectricModule,
        duty: Float[Array, "*cells"],
        cold_temperature: Float[Array, "*cells"],
        hot_temperature: Float[Array, "*cells"],
    ) -> CellHeat:
        """Heat flows of all cells.

        **Arguments:**

        - `module`: constants of the cells, each `(cells,)`.
        - `duty`: -1 to 1.
        - `cold_temperature`, `hot_temperature`: absolute, K.
        """
        loop = module.electrical_resistance + self.on_resistance
        emf = module.emf(hot_temperature - cold_temperature)
        share, sign = self._share_and_sign(duty)
        voltage = self._reaching(self.supply_voltage)
        if self.averaging == "voltage":
            drive = -duty * voltage
            current = self._limited((drive - emf) / (loop + share * self.supply_resistance))
            square = current**2
        else:
            drive = -sign * voltage
            on = self._limited((drive - emf) / (loop + self.supply_resistance))
            off = -emf / loop if self.off_phase == "brake" else jnp.zeros_like(emf)
            current = share * on + (1 - share) * off
            square = share * on**2 + (1 - share) * off**2
        if self.own_supply:
            own = np.array(self.own_supply)
            alone = self._reaching(self.own_voltage) / module.electrical_resistance
            current = jnp.where(own, -share * alone, current)
            square = jnp.where(own, share * alone**2, square)
        cold, hot = module.mean_heat_flows(current, square, cold_temperature, hot_temperature)
        return CellHeat(cold, hot, current, hot - cold)

    def supply_power(
        self,
        module: ThermoelectricModule,
        duty: Float[Array, "*times cells"],
        cold_temperature: Float[Array, "*times cells"],
        hot_temperature: Float[Array, "*times cells"],
    ) -> Float[Array, "*times cells"]:
        """Mean power that each cell's bridge draws from the supply, W.

        This is the power of the cell plus the heat in supply, leads and switches. It is negative if
        a cell is hot enough to drive its current back. A controller that limits the current is
        assumed to have no losses: the supply delivers the power at the lowered voltage.

        **Arguments:** those of `heat`.
        """
        loop = module.electrical_resistance + self.on_resistance
        emf = module.emf(hot_temperature - cold_temperature)
        share, sign = self._share_and_sign(duty)
        voltage = self._reaching(self.supply_voltage)
        if self.averaging == "voltage":
            drive = -duty * voltage
            power = self._power(drive, emf, loop + share * self.supply_resistance)
        else:
            drive = -sign * voltage
            power = share * self._power(drive, emf, loop + self.supply_resistance)
        if self.own_supply:
            alone = share * self._reaching(self.own_voltage) ** 2 / module.electrical_resistance
            power = jnp.where(np.array(self.own_supply), alone, power)
        return power

    def _reaching(self, voltage: Float[ArrayLike, "..."]) -> Float[Array, "..."]:
        """The part of a supply's voltage that reaches each bridge, V."""
        whole = jnp.asarray(voltage)
        return whole if self.supply_share is None else whole * self.supply_share

    def _share_and_sign(
        self, duty: Float[Array, "*times cells"]
    ) -> tuple[Float[Array, "*times cells"], Float[Array, "*times cells"]]:
        """The share of a period during which a cell is connected, and the sign of its voltage."""
        share, sign = jnp.abs(duty), jnp.sign(duty)
        if self.heaters:  # without the kink at 0, so that their heat has a derivative there
            heaters = np.array(self.heaters)
            share, sign = jnp.where(heaters, duty, share), jnp.where(heaters, 1.0, sign)
        if self.drive_exponent is not None:
            law = share_of_duty(duty, self.drive_exponent)
            share = jnp.where(np.array(self.own_supply), law, share)
        return share, sign

    def _limited(self, current: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """The current of a connected cell within the controller's limit, A."""
        if self.current_limit is None:
            return current
        limit = jnp.asarray(self.current_limit)
        return jnp.clip(current, -limit, limit)

    def _power(
        self,
        drive: Float[Array, "*shape"],
        emf: Float[Array, "*shape"],
        resistance: Float[ArrayLike, "*#shape"],
    ) -> Float[Array, "*shape"]:
        """The supply power of a connected cell, W; at the current limit, at the lowered voltage."""
        if self.current_limit is None:
            return drive * (drive - emf) / resistance
        current = self._limited((drive - emf) / resistance)
        return current * (emf + current * resistance)

r"""The physics: netlist, plate, thermoelectric module, driver, camera, and the twin of them all.

The temperatures $x$ of the nodes follow $C \dot x = -G x + g a + q(x, u, a)$ with the duty $u$ and
the ambient $a$, and the readings are $y = a + \gamma (W x - a)$: both stand in `_system`. On the
way there a rig becomes a list of nodes and links (`_netlist`), then constant arrays (`_wiring`),
then numbers for one set of parameter values (`System`). Which file holds what:

- the network: `_assembly` (of the parts, with one node for those that are always equal), `_plate`
  (finite volumes or a given circuit), `_placed` (what follows from the places of cells),
  `_expressions`
- heat: `_thermoelectric` (cells, eqs. 7 to 10 of the paper), `_driver` (PWM and bridge),
  `_heat_loss` (films and radiation); `_make_laws` writes laws as C and SPICE into `laws/`
- what is read: `_sensors` (weights, lags, pixels of a camera), `_registration` (where it looks, by
  the edges of the plate in a frame), `_plate_map`
- inputs besides the duty: `_input_effects`, the links and values that they change
- the twin: `_twin`, a rig with values
- faults: `_fault_models`, functions `System -> System`, and `_faults`, when they happen
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__, {"CALM": "MIN_FILM_RISE"})

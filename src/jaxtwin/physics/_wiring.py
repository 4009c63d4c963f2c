"""The structure of a rig as constant arrays: how nodes, links, cells and channels are connected.

Everything in this module is known before any parameter has a value. It is made once for a rig and
takes part in compiled code as a constant.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, Literal, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..errors import RigError
from ..rig import Driver, Input, Rig, Value
from ..rig._plate import AMBIENT
from ._assembly import build_netlist, lump
from ._expressions import Expressions
from ._heat_loss import LossPaths
from ._input_effects import InputWiring
from ._netlist import Netlist
from ._placed import on_plate_names
from ._registration import RegisteredZones
from ._sensors import node_weights

# Sums of links' values, grouped by the nodes at which the links end, from which the matrices of
# a network are assembled.


# The largest number of entries of a dense table of rows and links. A product with a larger table
# takes longer than adding up the few entries that are not 0, and its compilation takes minutes.
MAX_TABLE = 1 << 18


@final
class LinkSums:
    """Sums of values of links, one sum for each row.

    **Arguments:**

    - `rows`: the number of rows.
    - `members`: pairs (row, number of the link).
    - `links`: the number of links.
    """

    def __init__(self, rows: int, members: Sequence[tuple[int, int]], links: int):
        self.rows = rows
        self.members = np.array(members, dtype=np.int32).reshape(-1, 2).T
        self.table = None
        if rows * links <= MAX_TABLE:
            self.table = np.zeros((rows, links))
            self.table[*self.members] = 1.0

    def __call__(self, values: Float[Array, " links"]) -> Float[Array, " rows"]:
        if self.table is not None:
            return jnp.asarray(self.table, values.dtype) @ values
        row, link = self.members
        return jnp.zeros(self.rows, values.dtype).at[row].add(values[link])


# The largest number of elements of a plate. Their modes take a minute, and tables of their pairs a
# gigabyte.
MAX_ELEMENTS = 4000


@final
class Wiring:
    """Index arrays and expression tables of a rig, equal for rigs of equal content.

    - `netlist`, and `capacitances` of its nodes, `resistances` of its links, `initial` node
      temperatures, `ambient` temperature, `gains` of the channels, as `Expressions`;
      `module_constants` and `bridge_constants` likewise, with a row for each constant.
    - `conducting`: the numbers of the links that inputs or the places of cells change, and
      `conducting_sums`, their conductances as `Expressions`. `on_plate`: the names of quantities
      that are above 0 where these places are within their bounds.
    - `pair_sums`: sums over the links that connect each pair of neighbouring nodes, and `pairs` (2,
      pairs), these nodes. `pair_of` (nodes, nodes): the index of the pair of two nodes, or the
      number of pairs if they are not neighbours; None in a large network.
    - `ambient_sums`: sums over the links from each node to the surroundings.
    - `reservoirs`: the temperatures of the reservoirs as `Expressions`, and `reservoir_sums`: sums
      over the links from each node to the first reservoir, then to the second, and so on; both None
      without reservoirs.
    - `cold`, `hot` (cells,): the nodes of the cells' two sides, which are the same for a heater.
    - `heaters`, `own_supply`: for each cell whether it is a heater, and whether it has a supply of
      its own, see `ThermoelectricElement`; each empty if none is or has.
    - `drive_exponents`: of the duty of each cell and heater as `Expressions`, None if all are 1.
    - `channel_weights` (channels, nodes), and the `zones` that move them if the rig's camera has
      a registration, else None.
    - `elements`: the number of nodes of the plate, which are the first nodes.
    - `loss_paths`: where heat flows that is not linear; the `exponent` and the `radiating` area of
      each path as `Expressions`, `film_sums`: sums over the links of each element's film, and the
      `convection` of the other paths, None if there are none; all None if losses are linear.
    - `gain_names`: names of parameters that act only on gains of channels.
    - `lag` and `delay` of the command, the cells' `current_limit` and `ambient_drift` as
      `Expressions`, or None.
    - `position` (nodes of the rig,): the index of the node that represents each node of the rig,
      and `rig_elements`: the same for the elements of the plate, which are the first nodes.
    - `input_wiring`: the parts that the rig's inputs change, None without inputs.
    - `fingerprint`: a text that is equal for rigs of equal content, in every process.
    """

    def __init__(
        self,
        rig: Rig,
        netlist: Netlist,
        position: Int[np.ndarray, " rig_nodes"],
        weights: Float[np.ndarray, "channels rig_nodes"],
    ):
        self.netlist = netlist
        self.position = position
        self._connect_cells()
        self._evaluate_nodes_and_links(rig)
        self._evaluate_driver(rig.driver)
        self._sum_inner_links()
        self._sum_outer_links()
        self._sum_losses()
        self._place_channels(rig, weights)
        self.input_wiring = InputWiring(rig, netlist) if rig.inputs else None
        self.gain_names = self.gains.names - self._names_beside_gains()

        # The sizes are included, because the channels' weights depend on them and the netlist of a
        # circuit that is given link by link does not contain them.
        sizes = (rig.plate.columns, rig.plate.rows)
        ambient = (rig.ambient_temperature, rig.ambient_drift)
        registration = None if rig.camera is None else rig.camera.registration
        pixel = None if self.zones is None else self.zones.pixel_size
        parts = (rig.driver, rig.channels, registration, pixel, ambient, sizes, position.tolist())
        parts += (rig.inputs, rig.placements)
        self.fingerprint = netlist.fingerprint + repr(parts)

    @property
    def lowest_duty(self) -> Float[np.ndarray, " cells"]:
        """The lowest duty of each cell: -1, and 0 of a heater."""
        return np.array([0.0 if cell.is_heater else -1.0 for cell in self.netlist.cells])

    def _connect_cells(self) -> None:
        cells, index = self.netlist.cells, self.netlist.index
        self.cold = np.array([index[cell.cold] for cell in cells], dtype=np.int32)
        self.hot = np.array([index[cell.hot] for cell in cells], dtype=np.int32)
        self.module_constants = Expressions(
            [[cell.seebeck_coefficient] for cell in cells]
            + [[cell.electrical_resistance] for cell in cells]
            + [[cell.thermal_resistance or Value(1.0)] for cell in cells]
        )

    def _evaluate_nodes_and_links(self, rig: Rig) -> None:
        nodes, drift = self.netlist.nodes, rig.ambient_drift
        self.elements = sum(node.kind == "plate" for node in nodes)
        self.capacitances = Expressions([[node.capacitance] for node in nodes])
        # A link that is given by its conductance has a resistance of 1 here, in whose place its
        # conductance is put.
        links = self.netlist.links
        self.resistances = Expressions([link.resistances or [Value(1.0)] for link in links])
        conducting = [number for number, link in enumerate(links) if link.conductances]
        self.conducting = np.array(conducting, np.int32)
        self.conducting_sums = Expressions([links[number].conductances for number in conducting])
        self.on_plate = on_plate_names(rig)
        self.initial = Expressions([[node.initial_temperature] for node in nodes])
        self.ambient = Expressions([[rig.ambient_temperature]])
        self.ambient_drift = None if drift is None else Expressions([[drift]])

    def _evaluate_driver(self, driver: Driver) -> None:
        self.averaging: Literal["voltage", "on-off"] = driver.averaging
        self.off_phase: Literal["brake", "open"] = driver.off_phase
        cells = self.netlist.cells
        heaters = tuple(cell.is_heater for cell in cells)
        own = tuple(cell.has_own_supply for cell in cells)
        self.heaters = heaters if any(heaters) else ()
        self.own_supply = own if any(own) else ()
        laws = [cell.drive_exponent for cell in cells]
        self.drive_exponents = (
            Expressions([[law or Value(1.0)] for law in laws]) if any(laws) else None
        )
        self.bridge_constants = Expressions(
            [[driver.supply_voltage], [driver.supply_resistance], [driver.on_resistance]]
        )
        self.lag, self.delay, self.current_limit = (
            None if value is None else Expressions([[value]])
            for value in (driver.lag, driver.delay, driver.current_limit)
        )

    def _sum_inner_links(self) -> None:
        """The links between nodes: the pairs of neighbours, and the sums over their links."""
        links, index, count = self.netlist.links, self.netlist.index, len(self.netlist.nodes)
        inner = [
            (number, *sorted((index[link.a], index[link.b])))
            for number, link in enumerate(links)
            if link.b in index
        ]
        pairs = {pair: number for number, pair in enumerate(dict.fromkeys(p[1:] for p in inner))}
        between = [(pairs[a, b], number) for number, a, b in inner]
        self.pair_sums = LinkSums(len(pairs), between, len(links))
        self.pairs = np.array(list(pairs), dtype=np.int32).reshape(-1, 2).T
        self.pair_of = None
        if count**2 <= MAX_TABLE:
            self.pair_of = np.full((count, count), len(pairs), dtype=np.int32)
            self.pair_of[*self.pairs] = self.pair_of[*self.pairs[::-1]] = np.arange(len(pairs))

    def _sum_outer_links(self) -> None:
        """Sums the links to the surroundings and to the reservoirs."""
        links, index, count = self.netlist.links, self.netlist.index, len(self.netlist.nodes)
        self.ambient_sums = LinkSums(count, self._links_to_ambient(), len(links))
        self.reservoirs = self.reservoir_sums = None
        reservoirs = self.netlist.reservoirs
        if not reservoirs:
            return
        self.reservoirs = Expressions([[reservoir.temperature] for reservoir in reservoirs])
        first = {reservoir.name: count * n for n, reservoir in enumerate(reservoirs)}
        held = [
            (first[link.b] + index[link.a], number)
            for number, link in enumerate(links)
            if link.b in first
        ]
        self.reservoir_sums = LinkSums(len(first) * count, held, len(links))

    def _links_to_ambient(self) -> list[tuple[int, int]]:
        """Node and number of each link that leads to the surroundings."""
        index, links = self.netlist.index, self.netlist.links
        return [(index[link.a], n) for n, link in enumerate(links) if link.b == AMBIENT]

    def _sum_losses(self) -> None:
        """Sums the heat flows beyond those of the conductance matrix."""
        loss, links = self.netlist.loss, self.netlist.links
        self.exponent = self.radiating = self.film_sums = self.loss_paths = self.convection = None
        if loss is None:
            return
        areas, paths = dict(loss.radiators), loss.paths
        count = 0 if loss.exponent is None and not areas else self.elements
        of_plate = loss.exponent or Value(0.0)
        self.exponent = Expressions([[of_plate]] * count + [[path.exponent] for path in paths])
        elements = self.netlist.nodes[:count]
        self.radiating = Expressions(
            [*(areas.get(node.name, ()) for node in elements), *([p.radiating] for p in paths)]
        )
        films = [
            (node, number)
            for node, number in self._links_to_ambient()
            if node < count and links[number].role == "film"
        ]
        self.film_sums = LinkSums(count, films, len(links))
        self.convection = Expressions([[path.convection] for path in paths]) if paths else None
        held = [AMBIENT, *(reservoir.name for reservoir in self.netlist.reservoirs)]
        ends = self.netlist.index | {name: -1 - place for place, name in enumerate(held)}
        near = [*range(count), *(ends[path.a] for path in paths)]
        far = [-1] * count + [ends[path.b] for path in paths]
        self.loss_paths = LossPaths(np.array(near, np.int32), np.array(far, np.int32), count)

    def conductances(self, values_si: Mapping[str, Float[Array, ""]]) -> Float[Array, " links"]:
        """The conductances of all links, those that inputs change where no input is stated, W/K."""
        conductances = 1 / self.resistances(values_si)
        if self.conducting.size == 0:
            return conductances
        return conductances.at[self.conducting].set(self.conducting_sums(values_si))

    def conductance_numbers(
        self, values_si: Mapping[str, Any]
    ) -> Float[np.ndarray, "links *draws"]:
        """The same for plain numbers, or arrays of one shape, in NumPy."""
        conductances = 1 / self.resistances.numbers(values_si)
        if self.conducting.size > 0:
            changing = self.conducting_sums.numbers(values_si)
            conductances = np.broadcast_to(
                conductances.T, (*changing.shape[1:], len(conductances))
            ).T.copy()
            conductances[self.conducting] = changing
        return conductances

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The inputs of the rig besides the duty."""
        return () if self.input_wiring is None else self.input_wiring.inputs

    @property
    def inputs_and_effects(self) -> tuple[tuple[Input, bool], ...]:
        """The inputs, each with whether it changes a resistance of the network."""
        effects = self.input_wiring
        if effects is None:
            return ()
        names = effects.conductances.names
        return tuple(
            (rig_input, not names.isdisjoint(rig_input.names)) for rig_input in effects.inputs
        )

    def _place_channels(self, rig: Rig, weights: Float[np.ndarray, "channels rig_nodes"]) -> None:
        self.channels = tuple(channel.name for channel in rig.channels)
        self.gains = Expressions([[channel.gain] for channel in rig.channels])
        self.rig_elements = self.position[: len(rig.plate.element_names)]
        self.channel_weights = np.zeros((len(rig.channels), len(self.netlist.nodes)))
        np.add.at(self.channel_weights.T, self.position, weights.T)
        registration = None if rig.camera is None else rig.camera.registration
        self.zones = None if registration is None else RegisteredZones(rig, registration)

    def _names_beside_gains(self) -> set[str]:
        """Names of the parameters that act on anything but the gains of the channels."""
        tables = [part for part in vars(self).values() if isinstance(part, Expressions)]
        tables += [] if self.zones is None else [self.zones.registration]
        return set().union(*(part.names for part in tables if part is not self.gains))

    def moved_weights(
        self, values_si: Mapping[str, Float[Array, ""]]
    ) -> Float[Array, "channels nodes"] | None:
        """The weights of the nodes in the channels after the camera's registration; None for a rig
        without a registration, whose `channel_weights` never change."""
        if self.zones is None:
            return None
        weights = self.zones.element_weights(values_si)
        nodes = np.eye(len(self.netlist.nodes))[self.rig_elements]
        return weights @ jnp.asarray(nodes, weights.dtype)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Wiring) and self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)


@lru_cache(maxsize=64)
def wiring_of(rig: Rig, lumped: bool = False) -> Wiring:
    """Returns the wiring of a rig, which is made once. If `lumped`, nodes that are always equal are
    combined.

    **Raises:** `RigError` if the plate has more elements than a twin can have.
    """
    elements = len(rig.plate.element_names)
    if elements > MAX_ELEMENTS:
        raise RigError(
            f"{rig.source}: plate: expected at most {MAX_ELEMENTS} elements in a twin, got "
            f"{elements}; make the grid coarser"
        )
    netlist = build_netlist(rig)
    weights = node_weights(rig, netlist)
    if lumped:
        return Wiring(rig, *lump(netlist), weights)
    return Wiring(rig, netlist, np.arange(len(netlist.nodes), dtype=np.int32), weights)

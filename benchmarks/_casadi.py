"""CasADi with SUNDIALS' CVODES, mapped over the draws on all cores.

At its best: equations and their sparse Jacobian compiled by the system's C compiler where that
pays, the network's conductances as the integrator's parameters, a driver's lag as a function of
time (as states of their own, the duty cycles take a tenth longer and rule out the fastest linear
solver), gains inside the graph, and results written by CasADi into memory that numpy sees, so that
nothing is converted. Threads each take a part of the draws. `benchmarks.ways` searches the
settings.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from jaxtyping import Float

from jaxtwin.rig import FILM_REFERENCE

from ._equations import CALM, STEFAN_BOLTZMANN, Equations, equations, rooms, stretches
from ._task import Task

HAS_COMPILER = shutil.which("cc") is not None
FLAGS = ["-O3", "-march=native", "-ffast-math"]


@dataclass(frozen=True)
class CvodesSetting:
    """What a user of CasADi's CVODES chooses.

    - `reltol`: relative tolerance. `abstol`: absolute, K.
    - `linear_solver`: a name of CasADi's.
    - `compiled`: whether equations and Jacobian pass through the C compiler.
    """

    reltol: float
    abstol: float
    linear_solver: str
    compiled: bool

    def __str__(self) -> str:
        tolerances = f"{self.reltol:.0e}, {self.abstol:.0e} K".replace("e-0", "e-")
        return f"{tolerances}, {self.linear_solver}{', compiled' if self.compiled else ''}"


def cvodes(
    task: Task, count: int, setting: CvodesSetting
) -> Callable[[], Float[np.ndarray, "draws times channels"]]:
    """Whole trajectories, degC: a view of the memory that CasADi writes."""
    channels, samples = task.experiment.temperatures.shape[1], len(task.experiment.time)
    run = _mapped(task, count, setting, cost=False)
    return lambda: run().reshape(count, samples, channels)


def cvodes_cost(
    task: Task, count: int, setting: CvodesSetting
) -> Callable[[], Float[np.ndarray, " draws"]]:
    """The sum of squares of each draw alone, K^2, which CasADi forms inside its graph."""
    return _mapped(task, count, setting, cost=True)


def _mapped(
    task: Task, count: int, setting: CvodesSetting, cost: bool
) -> Callable[[], Float[np.ndarray, " numbers"]]:
    # CasADi leaves its C files in the current folder.
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        function, arguments = _built(task, count, setting, cost)
        # A draw behind the other, as CasADi keeps matrices.
        given = [np.ascontiguousarray(argument.T) for argument in arguments]
        answer = np.zeros(function.nnz_out(0))
        buffer, call = function.buffer()
        for number, argument in enumerate(given):
            buffer.set_arg(number, memoryview(argument.reshape(-1)))
        buffer.set_res(0, memoryview(answer))
        call()
    held = function, buffer, given  # `call` points into them and does not keep them alive

    def run() -> Float[np.ndarray, " numbers"]:
        assert held
        call()
        return answer

    return run


def _built(
    task: Task, count: int, setting: CvodesSetting, cost: bool
) -> tuple[ca.Function, list[Float[np.ndarray, "numbers draws"]]]:
    networks = [equations(twin) for twin in task.twins(count)]
    first = networks[0]
    options: dict[str, Any] = {
        "reltol": setting.reltol,
        "abstol": setting.abstol,
        "max_num_steps": 100_000,
        "linear_solver": setting.linear_solver,
    }
    if setting.compiled:
        options |= {"jit": True, "compiler": "shell", "jit_cleanup": False}
        options["jit_options"] = {"flags": FLAGS, "cleanup": False}
    numbers = np.stack([numbers_of(network) for network in networks], axis=1)
    p, x, t = ca.SX.sym("p", len(numbers)), ca.SX.sym("x", first.nodes), ca.SX.sym("t")
    before, command = ca.SX.sym("before", len(first.cold)), ca.SX.sym("u", len(first.cold))
    room, duty = ca.SX.sym("room"), command
    if first.lag:
        duty = command + (before - command) * ca.exp(-t / p[-1])
    problem = {
        "x": x,
        "t": t,
        "p": ca.vertcat(p, before, command, room),
        "ode": rate_of(first, x, p, duty, room),
    }
    # The time of each stretch begins at 0, so that those of a length share an integrator.
    integrators: dict[float, ca.Function] = {}
    x0, of_draw = ca.MX.sym("x0", x.shape[0]), ca.MX.sym("numbers", p.shape[0])
    gain, ambient = ca.MX.sym("gain", len(first.gain)), ca.MX.sym("ambient")
    states, now = [x0], ca.MX.zeros(len(first.cold))
    for start, end, held in stretches(task.experiment, first):
        length, drive = end - start, held[:-1]
        if length not in integrators:
            times = np.arange(1, length + 0.5).tolist()
            integrators[length] = ca.integrator("stretch", "cvodes", problem, 0, times, options)
        inputs = ca.vertcat(of_draw, now, ca.DM(held))
        states.append(integrators[length](x0=states[-1][:, -1], p=inputs)["xf"])
        if first.lag:
            now = drive + (now - drive) * ca.exp(-length / of_draw[-1])
    at_samples = ca.DM(rooms(task.experiment, first)).T
    rises = ca.horzcat(*states)[: first.nodes, :] - ca.repmat(at_samples, first.nodes, 1)
    read = ca.repmat(gain, 1, rises.shape[1]) * (ca.DM(first.weights) @ rises) + ambient
    readings = ca.densify(read + ca.repmat(at_samples, len(first.gain), 1))
    result = ca.sumsqr(readings - ca.DM(task.experiment.temperatures.T)) if cost else readings
    run_one = ca.Function("run", [x0, of_draw, gain, ambient], [result])
    run_all = run_one.map(count, "thread", os.cpu_count() or 1)
    return run_all, [
        np.stack([network.start for network in networks], axis=1),
        numbers,
        np.stack([network.gain for network in networks], axis=1),
        np.array([[network.ambient - 273.15 for network in networks]]),
    ]


def _pairs(network: Equations) -> list[tuple[int, int]]:
    rows, columns = np.nonzero(np.triu(network.conductance, 1))
    return list(zip(rows.tolist(), columns.tolist(), strict=True))


def _parts(network: Equations) -> list[Float[np.ndarray, " part"]]:
    """What differs between draws, in parts, each constant ready for use."""
    braked, loop = network.resistance + network.on_resistance, network.supply_resistance
    losses = np.zeros(0)
    if not network.linear_losses:
        losses = np.concatenate([network.film, STEFAN_BOLTZMANN * network.radiating])
    return [
        np.array([-network.conductance[a, b] for a, b in _pairs(network)]),
        network.conductance.sum(axis=1),
        1 / network.capacitance,
        network.seebeck,
        network.resistance,
        1 / braked,
        1 / (braked + loop),
        losses,
        np.array([network.ambient, network.exponent.max() / 2, network.lag]),
    ]


def numbers_of(network: Equations) -> Float[np.ndarray, " numbers"]:
    return np.concatenate(_parts(network))


def rate_of(network: Equations, x: ca.SX, numbers: ca.SX, duty: ca.SX, room: ca.SX) -> ca.SX:
    """The equations once more, symbolically, for duty cycles that are never negative."""
    sizes = [0, *(len(part) for part in _parts(network))]
    between, air, per_C, alpha, R, per_loop, per_on, losses, others = ca.vertsplit(
        numbers, np.cumsum(sizes).tolist()
    )
    nodes, ambient = network.nodes, others[0]
    heat = [air[node] * (room - x[node]) for node in range(nodes)]
    for number, (a, b) in enumerate(_pairs(network)):
        flow = between[number] * (x[a] - x[b])
        heat[a] -= flow
        heat[b] += flow
    if not network.linear_losses:
        elements = len(network.film)
        for node in range(elements):
            rise, around = x[node] - room, ambient + room
            square = (rise**2 + CALM**2) / (FILM_REFERENCE**2 + CALM**2)
            heat[node] -= losses[node] * (ca.exp(others[1] * ca.log(square)) - 1) * rise
            hot = around + rise
            radiated = rise * (hot + around) * (hot**2 + around**2)
            heat[node] -= losses[elements + node] * radiated
    for cell in range(len(network.cold)):
        cold, hot = int(network.cold[cell]), int(network.hot[cell])
        emf = alpha[cell] * (x[hot] - x[cold])
        for share, current in _phases(network, duty[cell], emf, per_loop[cell], per_on[cell]):
            joule = 0.5 * R[cell] * current**2
            heat[cold] -= share * (alpha[cell] * current * (x[cold] + ambient) - joule)
            heat[hot] += share * (alpha[cell] * current * (x[hot] + ambient) + joule)
    return ca.vertcat(*heat) * per_C


def _phases(
    network: Equations, duty: ca.SX, emf: ca.SX, per_loop: ca.SX, per_on: ca.SX
) -> list[tuple[Any, ca.SX]]:
    """The parts of a PWM period: share and current."""
    if network.averaging == "voltage":
        current = (-duty * network.supply_voltage - emf) * per_loop
        if network.supply_resistance:
            supply = 1 / per_on - 1 / per_loop
            current /= 1 + duty * supply * per_loop
        return [(1, current)]
    on = (duty, (-network.supply_voltage - emf) * per_on)
    return [on, (1 - duty, -emf * per_loop)] if network.off_phase == "brake" else [on]

"""CasADi with SUNDIALS' CVODES, mapped over the draws on all cores.

As fast as CasADi allows: equations and their sparse Jacobian compiled by the system's C compiler
where there is one, the network's conductances as the integrator's parameters, the linear solver
that measured best, a driver's lag as a function of time: as states of their own, the duty cycles
take a tenth longer and rule out the fastest linear solver. Threads each take a part of the draws.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from jaxtyping import Float

from jaxtwin.rig._plate import FILM_REFERENCE

from ._equations import CALM, STEFAN_BOLTZMANN, Equations, equations, stretches
from ._task import Task


def cvodes(
    task: Task, count: int, tolerance: float, linear_solver: str = "ldl"
) -> Callable[[], Float[np.ndarray, "d t c"]]:
    """With the tolerance relative and, in K, absolute."""
    # CasADi leaves its C files in the current folder.
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        run = _compiled(task, count, tolerance, linear_solver)
        run()
    return run


def _compiled(
    task: Task, count: int, tolerance: float, linear_solver: str
) -> Callable[[], Float[np.ndarray, "d t c"]]:
    networks = [equations(twin) for twin in task.twins(count)]
    first = networks[0]
    parameters = np.stack([_numbers(network) for network in networks], axis=1)
    starts = np.stack([network.start for network in networks], axis=1)
    options: dict[str, Any] = {
        "reltol": tolerance,
        "abstol": tolerance,
        "max_num_steps": 100_000,
        "linear_solver": linear_solver,
    }
    if shutil.which("cc") or shutil.which("gcc"):
        flags = ["-O3", "-march=native", "-ffast-math"]
        options |= {"jit": True, "compiler": "shell", "jit_cleanup": False}
        options["jit_options"] = {"flags": flags, "cleanup": False}
    p, x, t = ca.SX.sym("p", len(parameters)), ca.SX.sym("x", first.nodes), ca.SX.sym("t")
    before, command = ca.SX.sym("before", len(first.cold)), ca.SX.sym("u", len(first.cold))
    since = ca.SX.sym("since")
    duty = command
    if first.lag:
        duty = command + (before - command) * ca.exp((since - t) / p[-1])
    problem = {
        "x": x,
        "t": t,
        "p": ca.vertcat(p, before, command, since),
        "ode": _rate(first, x, p, duty),
    }
    x0, numbers = ca.MX.sym("x0", x.shape[0]), ca.MX.sym("numbers", p.shape[0])
    states, now = [x0], ca.MX.zeros(len(first.cold))
    for start, end, drive in stretches(task.experiment, first.delay):
        times = np.arange(start + 1, end + 0.5).tolist()
        integrator = ca.integrator("stretch", "cvodes", problem, start, times, options)
        inputs = ca.vertcat(numbers, now, ca.DM(drive), start)
        states.append(integrator(x0=states[-1][:, -1], p=inputs)["xf"])
        if first.lag:
            now = drive + (now - drive) * ca.exp((start - end) / numbers[-1])
    # Gains differ between draws and are applied afterwards.
    rises = ca.DM(first.weights) @ ca.horzcat(*states)[: first.nodes, :]
    run_one = ca.Function("run", [x0, numbers], [rises])
    run_all = run_one.map(count, "thread", os.cpu_count() or 1)
    gains = np.stack([network.gain for network in networks])[:, None, :]
    ambient = np.array([network.ambient for network in networks])[:, None, None]

    def run() -> Float[np.ndarray, "d t c"]:
        answer = np.asarray(run_all(starts, parameters)).reshape(len(first.gain), count, -1)
        return gains * np.moveaxis(answer, 0, -1) + ambient - 273.15

    return run


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
        np.array([network.ambient, network.exponent / 2, network.lag]),
    ]


def _numbers(network: Equations) -> Float[np.ndarray, " numbers"]:
    return np.concatenate(_parts(network))


def _rate(network: Equations, x: ca.SX, numbers: ca.SX, duty: ca.SX) -> ca.SX:
    """The equations once more, symbolically, for duty cycles that are never negative."""
    sizes = [0, *(len(part) for part in _parts(network))]
    between, air, per_C, alpha, R, per_loop, per_on, losses, others = ca.vertsplit(
        numbers, np.cumsum(sizes).tolist()
    )
    nodes, ambient = network.nodes, others[0]
    heat = [-air[node] * x[node] for node in range(nodes)]
    for number, (a, b) in enumerate(_pairs(network)):
        flow = between[number] * (x[a] - x[b])
        heat[a] -= flow
        heat[b] += flow
    if not network.linear_losses:
        elements = len(network.film)
        for node in range(elements):
            rise = x[node]
            square = (rise**2 + CALM**2) / (FILM_REFERENCE**2 + CALM**2)
            heat[node] -= losses[node] * (ca.exp(others[1] * ca.log(square)) - 1) * rise
            hot = ambient + rise
            radiated = rise * (hot + ambient) * (hot**2 + ambient**2)
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

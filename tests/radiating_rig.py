"""A rig of two bodies with natural convection, radiation and a heater that is not proportional, and
its equations by SciPy, written down here again."""

import tomllib

import numpy as np
from scipy.integrate import solve_ivp

from jaxtwin import Experiment
from jaxtwin.rig import Rig, rig_from_tables

TABLE = tomllib.loads("""
format = 1
name = "radiating"
ambient = { temperature = "20 degC" }
sensors = { noise = "0.1 K" }
channels = [{ name = "T1", nodes = ["block"] }, { name = "T2", nodes = ["shield"] }]
[[heaters]]
name = "H"
power = "30 W"
drive = "p"
contacts = ["block"]
[[bodies]]
name = "block"
capacitance = "60 J/K"
[[bodies]]
name = "shield"
capacitance = "40 J/K"
[[bodies]]
name = "wall"
temperature = "60 degC"
[[links]]
between = ["block-shield"]
resistance = "8 K/W"
convection = "0.05 W/K"
radiating_area = "100 cm^2"
emissivity = "eps"
[[links]]
between = ["shield-ambient"]
convection = "g"
convection_exponent = "n"
radiating_area = "200 cm^2"
[[links]]
between = ["wall-shield"]
radiating_area = "50 cm^2"
[parameters]
eps = { value = 0.8, unit = "", bounds = [0.05, 1.0], prior = { spread = 0.5 }, free = true }
g = { value = 0.1, unit = "W/K", bounds = [0.01, 1.0], prior = { spread = 0.5 }, free = true }
n = { value = 0.25, unit = "", bounds = [0.1, 0.5], prior = { spread = 0.3 } }
p = { value = 2.0, unit = "", bounds = [0.5, 3.0], prior = { spread = 0.3 }, free = true }
""")

DRIVE = Experiment.schedule("0:0.9,300:0.2,600:0,700:0.6", duration=900, step=10.0, cells=1)


def radiating_rig() -> Rig:
    return rig_from_tables(TABLE, "radiating")


def by_scipy(experiment: Experiment, *, eps=0.8, g=0.1, n=0.25, p=2.0) -> np.ndarray:
    """The temperatures of both bodies at the samples, degC, by SciPy's Radau."""
    sigma, room = 5.670374419e-8, 293.15

    def film(at_20_kelvin, exponent, rise):
        # Still air below 1 K, as the manual says.
        return at_20_kelvin * ((rise**2 + 1) / (20**2 + 1)) ** (exponent / 2) * rise

    def slope(time, state, duty):
        block, shield = state
        between = (block - shield) / 8 + film(0.05, 0.25, block - shield)
        between += sigma * eps * 0.01 * (block**4 - shield**4)
        lost = film(g, n, shield - room) + sigma * 0.02 * (shield**4 - room**4)
        lost += sigma * 0.005 * (shield**4 - 333.15**4)
        return [(30 * duty**p - between) / 60, (between - lost) / 40]

    states = [np.array([room, room])]
    for start, stop, duty in zip(
        experiment.time[:-1], experiment.time[1:], experiment.duty[:, 0], strict=False
    ):
        solution = solve_ivp(
            slope, (start, stop), states[-1], "Radau", args=(duty,), rtol=1e-9, atol=1e-9
        )
        states.append(solution.y[:, -1])
    return np.array(states) - 273.15

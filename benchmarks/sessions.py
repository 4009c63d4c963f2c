"""What differs between the sessions of the single-cell rig?

- The sessions matched together, and each predicted by a match to the others.
- Each session matched by itself (`match_many`), and all together with a value of every parameter
  for each session under a hierarchical prior: pictures of the values over the sessions.
- The parameter that explains a session: by how much the cost falls if the parameter has another
  value in this session alone. The fall is that of a linear model about the match (a score test),
  in which all other unknowns are matched again.

    python -m benchmarks.sessions FOLDER_WITH_RECORDINGS OUT
"""

import argparse
import tomllib
from pathlib import Path

import numpy as np

from jaxtwin import Experiment, Fit, Twin, leave_one_out, match, match_many, plots, read_recording
from jaxtwin.data import data_folder
from jaxtwin.matching._descent import descend
from jaxtwin.matching._fit import solution_of
from jaxtwin.matching._match import default_solver
from jaxtwin.matching._objective import make_objective
from jaxtwin.rig import rig_from_tables

BETWEEN = 0.2
"""Prior standard deviation of a parameter between sessions, as a part of its own prior's."""


def with_values_for_each_session() -> Twin:
    """The rig with every shared parameter that has a prior as one of each group."""
    rig = tomllib.loads((data_folder() / "rigs" / "single-cell.toml").read_text())
    for row in rig["parameters"].values():
        if "prior" in row and "scope" not in row:
            row["scope"] = "group"
            row["prior"]["between_groups"] = BETWEEN * row["prior"]["spread"]
    return Twin(rig_from_tables(rig, "single-cell, each session"))


def falls_of_cost(fit: Fit) -> np.ndarray:
    """By how much the cost falls if a shared parameter differs in a recording, `(shared,
    recordings)`."""
    solution = solution_of(fit)
    problem = solution.problem
    objective = make_objective(problem, solution.noise_model)
    space = problem.unknowns.search_space()
    (result,) = descend(
        [problem], [objective], default_solver(problem), [solution.vector], space, 0
    )
    with_priors = result.jacobian()
    size = with_priors.shape[1]
    slopes = with_priors[: len(with_priors) - size - len(problem.linear_prior.values)]
    (group,) = objective.same_shape_batches
    rows, residuals, row = np.zeros(len(slopes), int), [], 0
    errors = result.recording_errors()
    for kind in ("channel", "common_mode", "sizes"):
        part = np.asarray(getattr(group.weights, kind))
        for number, position in enumerate(group.positions):
            count = part[number].size
            rows[row : row + count] = position
            weighed = np.zeros(part[number].shape)
            if kind != "sizes":
                seen = getattr(errors[position], kind)
                weighed[: len(seen)] = part[number][: len(seen)] * seen
            residuals.append(weighed.ravel())
            row += count
    own = np.concatenate(residuals)
    normal = slopes.T @ slopes + problem.prior_precision
    inverse = np.linalg.inv(normal)
    shared = problem.unknowns.shared
    found = np.zeros((len(shared), len(problem.experiments)))
    for entry, parameter in enumerate(shared):
        assert parameter.prior_spread is not None
        for recording in range(len(problem.experiments)):
            more = np.where(rows == recording, slopes[:, entry], 0.0)
            across = slopes.T @ more
            information = more @ more + parameter.prior_spread**-2 - across @ inverse @ across
            found[entry, recording] = 0.5 * (more @ own) ** 2 / information
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    sessions = [read_recording(path) for path in sorted(options.folder.glob("*.mat"))]
    names = [f"session {number}" for number in range(1, len(sessions) + 1)]
    twin = Twin("single-cell")
    together = match(twin, sessions)
    print(together.summary())
    falls = falls_of_cost(together)
    print(f"\n| parameter | {' | '.join(names)} |\n|---|{'---:|' * len(names)}")
    for parameter, row in zip(solution_of(together).problem.unknowns.shared, falls, strict=True):
        print(f"| `{parameter.name}` | {' | '.join(f'{fall:.1f}' for fall in row)} |", flush=True)
    print(leave_one_out(twin, sessions).summary(), flush=True)
    alone = match_many(twin, [[session] for session in sessions])
    found = {name: fit for name, fit in zip(names, alone, strict=True) if fit is not None}
    plots.plot_group_values(found).savefig(options.out / "sessions-alone.png", dpi=110)
    hierarchical = match(with_values_for_each_session(), sessions, groups=names)
    plots.plot_group_values(hierarchical).savefig(options.out / "sessions.png", dpi=110)
    _print(found, hierarchical, sessions)


def _print(alone: dict[str, Fit], fit: Fit, sessions: list[Experiment]) -> None:
    print(f"hierarchical: mean fit {fit.mean_fit_percent:.2f} %, cost {fit.cost:.1f}")
    print({name: round(value, 2) for (name, _), value in fit.fit_percent.items()})
    errors = fit.uncertainty.standard_errors
    groups = list(dict.fromkeys(fit.groups.values()))
    for name in fit.group_values[groups[0]]:
        cells = []
        for group in groups:
            value = fit.group_values[group][name]
            by_itself = alone[group][name].value if group in alone else np.nan
            cells.append(f"{value:.3g} ± {errors[f'{name}[{group}]']:.2g} ({by_itself:.3g})")
        print(f"| `{name}` | {' | '.join(cells)} |")
    for session, values in zip(sessions, fit.recording_values.values(), strict=True):
        print(session.name, {key: round(value, 2) for key, value in values.items()})


if __name__ == "__main__":
    main()

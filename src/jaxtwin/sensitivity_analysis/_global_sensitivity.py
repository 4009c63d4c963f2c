"""The result of a global sensitivity analysis."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Bool, Float, Int

from .._display import picture
from .._name_suggestions import did_you_mean
from .._result import AbstractResult, dataset
from ..errors import ParameterError
from ._method import AbstractMethod, Design
from ._outputs import Output, labels_of
from ._sensitivity import MEAN

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes


@final
@dataclass(frozen=True, repr=False, eq=False)
class GlobalSensitivity(AbstractResult):
    """Sensitivity indices of several outputs, all from the same runs.

    `result["ST"]` is the index of that name, `(outputs, parameters)`, NaN for an output that does
    not vary. An index that SALib has too has its name. `result.problem`, `result.samples` and a
    column of `result.values` are arguments of SALib's analysers.

    **Arguments:**

    - `rig`: name of the rig.
    - `method`: which method. `design`: its runs.
    - `outputs`: the quantity in each column of `values`, with its unit.
    - `indices`: name -> `(outputs, parameters)`; `(outputs,)` for an index of an output as a whole,
      such as `R2`; `(outputs, parameters, parameters)` for an index of pairs, such as `S2`, of
      which the upper triangle is filled.
    - `values`: the outputs of each run, `(runs, outputs)`; NaN for a failed run.
    - `counted`: the number of complete blocks of runs for each output; other blocks are left out of
      the indices.
    - `failed`: whether a run gave an output that is not finite.
    - `seed`: the seed of samples and resamples. `wall_time`: the computing time, s, including
      compilation.
    """

    rig: str
    method: AbstractMethod
    design: Design
    outputs: tuple[Output, ...]
    indices: Mapping[str, Float[np.ndarray, "outputs ..."]]
    values: Float[np.ndarray, "runs outputs"]
    counted: Int[np.ndarray, " outputs"]
    failed: Bool[np.ndarray, " runs"]
    seed: int
    wall_time: float

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters."""
        return self.design.inputs.names

    @property
    def labels(self) -> tuple[str, ...]:
        """The outputs as text, such as "cost T11"."""
        return labels_of(self.outputs)

    @property
    def samples(self) -> Float[np.ndarray, "runs parameters"]:
        """The parameters of each run, in their units."""
        return self.design.samples

    @property
    def problem(self) -> dict[str, Any]:
        """The problem as `to_salib` returns it."""
        return self.to_salib()

    def __getitem__(self, name: str) -> Float[np.ndarray, "outputs ..."]:
        """Returns the index of this name.

        **Raises:** `ParameterError` if the method does not have it.
        """
        if name not in self.indices:
            raise ParameterError(
                f"{self.method.name}: expected one of {', '.join(self.indices)}, got {name!r}"
                f"{did_you_mean([name], self.indices)}"
            )
        return self.indices[name]

    def ranking(self, output: str | None = None) -> tuple[str, ...]:
        """Returns the parameters from the strongest to the weakest, by the size of the method's
        main index.

        **Arguments:**

        - `output`: one of `labels`; None for the mean cost, or the first output if there is
          none.

        **Raises:** `ParameterError` if there is no such output.
        """
        strength = np.abs(self[self.method.main][self.row(output)])
        order = np.argsort(-np.nan_to_num(strength, nan=-1.0), kind="stable")
        return tuple(self.names[column] for column in order)

    def row(self, output: str | None = None) -> int:
        """Returns the position of an output among `outputs`. The arguments are those of
        `ranking`."""
        if output is None:
            means = [n for n, each in enumerate(self.outputs) if each.channel == MEAN]
            return means[0] if means else 0
        if output not in self.labels:
            shown = ", ".join(self.labels[:20]) + (" ..." if len(self.labels) > 20 else "")
            raise ParameterError(
                f"output: expected one of {shown}, got {output!r}"
                f"{did_you_mean([output], self.labels)}"
            )
        return self.labels.index(output)

    def plot(self, output: str | None = None, ax: "Axes | None" = None) -> "Axes":
        """Plots the indices of an output in the form usual for the method: Sobol's as bars of `S1`
        and `ST`, Morris's as a plane of `mu_star` and `sigma`, others as a bar for each parameter.

        **Arguments:** as in `ranking`, and

        - `ax`: axes to draw into, or None for a new figure.
        """
        return picture("plot_sensitivity_indices", self, output, ax=ax)

    def plot_over_time(
        self, channel: str | None = None, index: str | None = None, ax: "Axes | None" = None
    ) -> "Axes":
        """Plots an index of a channel's temperature over time. The analysis must have
        `outputs=["temperature"]`.

        **Arguments:**

        - `channel`: its name; None for the first.
        - `index`: its name; None for the method's main index.
        - `ax`: axes to draw into, or None for a new figure.

        **Raises:** `ParameterError` if there is no such channel with several times.
        """
        return picture("plot_indices_over_time", self, channel, index, ax=ax)

    def plot_convergence(
        self, output: str | None = None, index: str | None = None, ax: "Axes | None" = None
    ) -> "Axes":
        """Plots an index of an output over the number of draws, estimated from the first draws of
        this analysis: `jaxtwin.plots.plot_convergence`.

        **Arguments:** as in `plot_over_time`, and

        - `output`: one of `labels`; None for the mean cost, or the first output.

        **Raises:** `ParameterError` if the method cannot estimate indices from a part of its draws.
        """
        return picture("plot_convergence", self, output, index, ax=ax)

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for each output and parameter (its index), and a column for
        each sensitivity index.

        An index of an output as a whole, such as `R2`, is in each of its rows. Indices of pairs are
        in `pairs_to_dataframe`.
        """
        dimensions = ("", "output", "output parameter")
        columns = {
            name: (dimensions[values.ndim], values)
            for name, values in self.indices.items()
            if values.ndim < 3
        }
        labelled = dataset(columns, {}, output=self.labels, parameter=self.names)
        return labelled.to_dataframe(dim_order=["output", "parameter"])

    def pairs_to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for each output and pair of parameters (its index), and a
        column for each sensitivity index of pairs, such as `S2`. It has no columns if the method
        has no such index."""
        import pandas

        first, second = np.triu_indices(len(self.names), 1)
        pairs = [(self.names[j], self.names[k]) for j, k in zip(first, second, strict=True)]
        rows = pandas.MultiIndex.from_tuples(
            [(label, *pair) for label in self.labels for pair in pairs],
            names=["output", "parameter", "other"],
        )
        columns = {
            name: values[:, first, second].ravel()
            for name, values in self.indices.items()
            if values.ndim == 3
        }
        return pandas.DataFrame(columns, index=rows)

    def to_xarray(self) -> "xarray.Dataset":
        """Returns all numbers as a labelled dataset with the dimensions output, parameter, other
        (of a pair) and run."""
        dimensions = ("", "output", "output parameter", "output parameter other")
        variables: dict[str, Any] = {
            name: (dimensions[values.ndim], values) for name, values in self.indices.items()
        }
        variables |= {
            "sample": ("run parameter", self.samples),
            "value": ("run output", self.values),
            "failed": ("run", self.failed),
            "counted": ("output", self.counted),
        }
        described = ("quantity", "channel", "time", "recording", "unit")
        for name in described:
            variables[name] = ("output", [getattr(each, name) for each in self.outputs])
        labels = {"output": self.labels, "parameter": self.names}
        if any(values.ndim == 3 for values in self.indices.values()):
            labels["other"] = self.names
        attributes = {
            "rig": self.rig,
            "method": self.method.name,
            "seed": self.seed,
            "block": self.design.block,
        }
        return dataset(variables, attributes, **labels).set_coords(described)

    def to_salib(self) -> dict[str, Any]:
        """Returns the problem in SALib's form, for its samplers and analysers.

        **Raises:** `ParameterError` for correlated parameters, which SALib's form cannot represent.
        """
        return self.design.inputs.to_salib()

    def _for_json(self) -> dict[str, Any]:
        return {
            "rig": self.rig,
            "method": self.method.name,
            "runs": len(self.failed),
            "failed": int(self.failed.sum()),
            "blocks": self.design.blocks,
            "counted": dict(zip(self.labels, self.counted, strict=True)),
            "seed": self.seed,
            "wall_time_s": self.wall_time,
            "parameters": self.names,
            "indices": {
                name: dict(zip(self.labels, values, strict=True))
                for name, values in self.indices.items()
            },
            "ranking": self.ranking(),
        }

    def _overview(self) -> "pandas.DataFrame":
        output = self.labels[self.row()]
        rows = self.to_dataframe().loc[output].loc[list(self.ranking())]
        return rows.rename_axis(f"parameter, for {output}")

    def __repr__(self) -> str:
        indices = self[self.method.main][self.row()]
        known = [name for name in self.ranking() if np.isfinite(indices[self.names.index(name)])]
        strongest = f"strongest {', '.join(known[:3])}" if known else "no index is known"
        missing = self.design.blocks - int(self.counted.min())
        lost = ""
        if missing:
            lost = f" ({missing} of {self.design.blocks} blocks of runs incomplete, left out)"
        return (
            f"<GlobalSensitivity of {self.rig} by {self.method.name}: {len(self.failed)} runs"
            f"{lost}, {len(self.outputs)} outputs, {strongest}>"
        )

"""The result of a DC sweep of a thermoelectric module."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from jaxtyping import Float

from .._display import html_table, picture

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@final
@dataclass(frozen=True, repr=False)
class DCSweep:
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
    delta_T: Float[np.ndarray, " differences"]  # noqa: N815
    T_hot: float
    heat_flow: Float[np.ndarray, "differences currents"]
    power: Float[np.ndarray, "differences currents"]

    @property
    def cop(self) -> Float[np.ndarray, "differences currents"]:
        """Coefficient of performance $Q_c / P$; NaN if no power flows."""
        power = np.where(self.power > 0, self.power, np.nan)
        return self.heat_flow / power

    def plot(self) -> "Figure":
        """Plots the curves over the current: `jaxtwin.plots.plot_dc_curves`."""
        return picture("plot_dc_curves", self)

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for each temperature difference and current (its index) and
        the columns heat_flow (W), power (W) and cop."""
        return self.to_xarray().to_dataframe()

    def __repr__(self) -> str:
        low, high = self.current.min(), self.current.max()
        return (
            f"<DCSweep at T_hot = {self.T_hot:g} K: {len(self.current)} currents, {low:g} to "
            f"{high:g} A, at {len(self.delta_T)} differences>"
        )

    def _repr_html_(self) -> str:
        rows = [
            (f"{difference:g}", f"{pumped.max():.3g}", f"{self.current[pumped.argmax()]:.3g}")
            for difference, pumped in zip(self.delta_T, self.heat_flow, strict=True)
        ]
        return html_table(repr(self), ("delta_T, K", "most heat, W", "at, A"), rows)

    def to_xarray(self) -> "xarray.Dataset":
        """Returns the curves as a dataset with dimensions (delta_T, current) and units in the
        attributes."""
        import xarray

        dims = ("delta_T", "current")
        return xarray.Dataset(
            {
                "heat_flow": (dims, self.heat_flow, {"units": "W"}),
                "power": (dims, self.power, {"units": "W"}),
                "cop": (dims, self.cop, {"units": "1"}),
            },
            coords={
                "delta_T": ("delta_T", self.delta_T, {"units": "K"}),
                "current": ("current", self.current, {"units": "A"}),
            },
            attrs={"T_hot_K": self.T_hot},
        )

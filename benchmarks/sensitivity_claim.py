"""Does the paper's "R_pc, R_E and R_Th lead" hold?

The free parameters' Pearson correlations with the mean cost for 50 and 10 000 draws, their rank
correlations, and their Sobol indices of the cost and of its logarithm, whose tail is not heavy, for
the authors' three recordings: at the published values, at the values of a match with jaxtwin
(`--parameters fit.toml`, as `jaxtwin match` writes it), and over the bounds of Table 4.

    python -m benchmarks.sensitivity_claim --parameters fit.toml
"""

import argparse

import numpy as np

import jaxtwin as jt
from jaxtwin.sensitivity_analysis import Sobol, Spearman, indices_of


def claim(base: int, parameters: str | None) -> None:
    """Prints a table for each centre."""
    rig = jt.load_rig("paper-2024")
    experiments = [jt.read_recording(path) for path in jt.find_recordings()]
    published = jt.Twin(rig, rig.parameter_sets["published"])
    centres: list[tuple[str, jt.Twin, dict[str, str]]] = [
        ("published values, +-25 %", published, {"inputs": "normal"}),
    ]
    if parameters:
        centres.append(("matched values, +-25 %", jt.Twin(rig, parameters), {"inputs": "normal"}))
    centres.append(("uniform in the bounds of Table 4", published, {"inputs": "bounds"}))
    for words, twin, options in centres:
        few, many, variance = (
            jt.sensitivity(twin, experiments, method=method, draws=draws, **options)  # pyright: ignore[reportArgumentType, reportCallIssue]
            for method, draws in (("pearson", 50), ("pearson", 10_000), ("sobol", base))
        )
        row = variance.row()
        ranks, _ = indices_of(Spearman(), many.design, many.values[:, [row]])
        logarithm, _ = indices_of(Sobol(), variance.design, np.log(variance.values[:, [row]]))
        columns = {
            "Pearson, 50": few["pearson"][row],
            "Pearson, 10 000": many["pearson"][row],
            "Spearman, 10 000": ranks["spearman"][0],
            f"S1, {base}": variance["S1"][row],
            f"ST, {base}": variance["ST"][row],
            "S1 of log cost": logarithm["S1"][0],
            "ST of log cost": logarithm["ST"][0],
        }
        widest = [
            (few["pearson_high"] - few["pearson_low"])[row].max() / 2,
            (many["pearson_high"] - many["pearson_low"])[row].max() / 2,
            (ranks["spearman_high"] - ranks["spearman_low"])[0].max() / 2,
            *(variance[f"{name}_conf"][row].max() for name in ("S1", "ST")),
            *(logarithm[f"{name}_conf"][0].max() for name in ("S1", "ST")),
        ]
        print(f"\n{words}: {few!r}, {many!r}, {variance!r}")
        print(f"{'':10s}" + "".join(f"{name:>18s}" for name in columns))
        for place in np.argsort(-columns["ST of log cost"]):
            cells = "".join(f"{column[place]:18.3f}" for column in columns.values())
            print(f"{variance.names[place]:10s}{cells}")
        print(f"{'widest +-':10s}" + "".join(f"{width:18.3f}" for width in widest))


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--base", type=int, default=2048, help="base samples")
    parser.add_argument("--parameters", help="a saved fit")
    options = parser.parse_args()
    claim(options.base, options.parameters)


if __name__ == "__main__":
    main()

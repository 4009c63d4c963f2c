"""The demo's numbers beside their expected values."""

from ._blocks import ReportTable

# Number -> (what it is, what it should be, lowest, highest). Counts and sums are those of the
# authors' model file; the fit of the published values is that of an independent implementation.
EXPECTED_NUMBERS = {
    "plate_nodes": ("plate elements", "24", 24, 24),
    "plate_resistances": ("resistances on the plate", "83", 83, 83),
    "states": ("states", "28", 28, 28),
    "plate_capacitance_J_per_K": ("heat capacity of the plate, J/K", "681.7", 681.6, 681.8),
    "plate_to_ambient_W_per_K": ("plate to ambient, W/K", "4.604", 4.6035, 4.6045),
}
EXPECTED_OF_RECORDINGS = {
    "published_mean_fit_percent": ("mean fit, published values, %", "69.2 ± 0.3", 68.9, 69.5),
    "published_rmse_K": ("RMSE, published values, K", "1.79 ± 0.02", 1.77, 1.81),
    "fixed_mean_fit_percent": ("mean fit, ambient 15 °C, %", "above 69.2", 69.2, 100),
    "own_mean_fit_percent": ("mean fit, one ambient per recording, %", "at least 83", 83, 100),
}


def check_table(numbers: dict[str, float | int], real: bool) -> ReportTable:
    """A table of the demo's numbers beside numbers that are known from elsewhere.

    **Arguments:**

    - `numbers`: the numbers of the demo.
    - `real`: whether the recordings are the paper's; otherwise there is less to compare with.
    """
    expected = EXPECTED_NUMBERS | (EXPECTED_OF_RECORDINGS if real else {})
    rows = []
    for key, (what, should, low, high) in expected.items():
        right = low <= numbers[key] <= high
        rows.append(
            (what, should, f"{numbers[key]:.4g}", "as it should be" if right else "!differs")
        )
    return ReportTable("What can be checked.", ("", "should be", "here", ""), rows)

"""A sweep around a fit: each recording under its own values."""

from small_results import fit

from jaxtwin.sweeps._plan import plan_sweep


def test_a_sweep_of_a_fit_is_that_of_its_twins():
    plan = plan_sweep(
        fit(), None, draws=4, spread=0.25, seed=0, names=None, reductions=None,
        precision="float64", chunk_size=4,
    )  # fmt: skip
    first, second = (values["T_amb"] for values in fit().recording_values.values())
    assert abs(first - second) > 1
    assert [values["T_amb"] for values in plan.identity["values"]] == [first, second]
    assert plan.recordings == ("synthetic-A", "synthetic-B")

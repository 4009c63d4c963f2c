"""The laws of heat as C are those of Python: their text is current, and so are their numbers."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiled_c import ran

from jaxtwin._jax_settings import own_settings
from jaxtwin.physics._driver import share_of_duty
from jaxtwin.physics._heat_loss import LAW_FOLDER, lost_heat
from jaxtwin.physics._make_laws import law_files, traced

# The smallest and the largest argument.
RANGES = {
    lost_heat: [(-40, 90), (250, 320), (0.01, 5), (0.05, 0.5), (0, 1e-9), (0, 1e8)],
    share_of_duty: [(-1, 1), (0.5, 3)],
}

MAIN = """
#include <math.h>
#include <stdio.h>
#define model_real double
#define model_number(constant) (constant)
#define model_raised pow
#include "{file}"
int main(void)
{{
    double a[{count}];
    while (scanf("{format}", {addresses}) == {count}) {{
        {call}
        printf("%.17g %.17g\\n", first, second);
    }}
    return 0;
}}
"""


def test_the_files_are_those_that_the_laws_give():
    """If this fails after a change of a law: make laws."""
    files = {path.name: path.read_text(encoding="ascii") for path in LAW_FOLDER.iterdir()}
    assert files == law_files()


def test_an_operation_without_a_rule_is_refused():
    with pytest.raises(NotImplementedError, match=r"a law: expected operations of .*, got sin"):
        traced(lambda x: jax.lax.sin(x))


def test_an_exponential_that_is_no_power_is_refused():
    with pytest.raises(NotImplementedError, match="got another exponential"):
        traced(lambda x: jax.lax.exp(x))


@pytest.mark.parametrize(
    ("law", "terms"),
    [
        (lambda x: 1 * x + 0 * x - 0, ["x"]),
        (lambda x: 2 * x + -(x * 3), [("-", ("*", 2.0, "x"), ("*", "x", 3.0))]),
        (lambda x: x**-2, [("/", 1.0, ("*", "x", "x"))]),
    ],
    ids=["factors 0 and 1", "signs", "a negative power"],
)
def test_terms_are_simplified(law: Callable, terms: list):
    assert traced(law) == terms


def of_c(file: Path, call: str, rows: np.ndarray, folder: Path) -> np.ndarray:
    """Two numbers that a call in C gives for each row of arguments."""
    count = rows.shape[1]
    text = MAIN.format(
        file=file,
        count=count,
        format=" ".join(["%lf"] * count),
        addresses=", ".join(f"&a[{k}]" for k in range(count)),
        call=call.format(", ".join(f"a[{k}]" for k in range(count))),
    )
    (folder / "main.c").write_text(text)
    subprocess.run(["cc", "-std=c99", "main.c", "-o", "main", "-lm"], cwd=folder, check=True)
    return ran(folder / "main", rows)


@pytest.mark.c_compiler
@pytest.mark.parametrize("law", RANGES, ids=lambda law: law.__name__)
def test_c_gives_the_law_and_its_derivatives(law: Callable, tmp_path: Path):
    low, high = np.array(RANGES[law]).T
    rows = np.random.default_rng(0).uniform(low, high, (200, len(low)))
    name = law.__name__
    value = of_c(
        LAW_FOLDER / f"{name}.c", f"double first = model_{name}({{}}), second = 0;", rows, tmp_path
    )[:, 0]
    ends = law is lost_heat
    pointers = "&first, &second" if ends else "&first"
    call = f"double first, second = 0; model_{name}_slopes({{}}, {pointers});"
    slopes = of_c(LAW_FOLDER / f"{name}_slopes.c", call, rows, tmp_path)
    with own_settings():
        columns = tuple(jnp.asarray(rows.T))
        expected = np.asarray(law(*columns))
        by = np.asarray(jax.vmap(jax.grad(law, argnums=tuple(range(1 + ends))))(*columns))
    np.testing.assert_allclose(value, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(slopes[:, 0], by[0], rtol=1e-11, atol=1e-11)
    if ends:  # the far end, by the rise and by its own temperature
        np.testing.assert_allclose(slopes[:, 1], by[1] - by[0], rtol=1e-11, atol=1e-11)

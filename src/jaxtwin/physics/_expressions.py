"""Many physical values as one matrix product, so that a rig of any size compiles quickly."""

from collections.abc import Mapping, Sequence
from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..rig import Value


@final
class Expressions:
    """Sums of values (products of parameters), all evaluated at once.

    A network has hundreds of values but few distinct products of parameters. These products are
    computed singly, and a constant matrix adds them up.

    **Arguments:**

    - `sums`: each entry of the result is the sum of these values.

    `names` are the names of the parameters in these values.
    """

    def __init__(self, sums: Sequence[Sequence[Value]]):
        distinct = dict.fromkeys(value.powers for terms in sums for value in terms)
        column = {powers: number for number, powers in enumerate(distinct)}
        self.products = tuple(Value(1.0, powers) for powers in distinct)
        self.names = frozenset(name for powers in distinct for name, _ in powers)
        factors = np.zeros((len(sums), len(distinct)))
        for row, terms in enumerate(sums):
            for value in terms:
                factors[row, column[value.powers]] += value.factor
        self.factors = factors

    def __call__(self, values_si: Mapping[str, Any]) -> Float[Array, " sums"]:
        """The sums for given parameters in SI units."""
        products = [jnp.asarray(value.evaluate(values_si)) for value in self.products]
        if not products:
            return jnp.zeros(len(self.factors))
        stacked = jnp.stack(jnp.broadcast_arrays(*products))
        return jnp.asarray(self.factors, stacked.dtype) @ stacked

    def numbers(self, values_si: Mapping[str, Any]) -> Float[np.ndarray, "sums *draws"]:
        """The sums for plain numbers, or arrays of one shape, in NumPy: without the compilation of
        hundreds of scalars that the places of cells determine."""
        products = [value.evaluate(values_si) for value in self.products]
        if not products:
            return np.zeros(len(self.factors))
        return np.tensordot(self.factors, np.stack(np.broadcast_arrays(*products)), axes=1)

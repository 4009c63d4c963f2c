"""Networks as matrices built without the package's own code."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest
from small_rigs import make_rig as make_rig

from jaxtwin.physics import Link

Network = Callable[..., tuple[np.ndarray, np.ndarray]]


@pytest.fixture
def network() -> Network:
    """Conductance matrix and conductances to the surroundings, summed link by link, W/K."""

    def build(
        nodes: Sequence[str], links: Sequence[Link], values: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        place = {name: number for number, name in enumerate(nodes)}
        matrix, ambient = np.zeros((len(nodes), len(nodes))), np.zeros(len(nodes))
        for link in links:
            conductance = 1 / sum(part.evaluate(values) for part in link.resistances)
            a = place[link.a]
            matrix[a, a] += conductance
            if link.b == "ambient":
                ambient[a] += conductance
            else:
                b = place[link.b]
                matrix[b, b] += conductance
                matrix[a, b] -= conductance
                matrix[b, a] -= conductance
        return matrix, ambient

    return build

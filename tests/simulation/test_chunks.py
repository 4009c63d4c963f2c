"""How draws are divided into chunks, whose sizes are few and hold few copies."""

import numpy as np
import pytest

from jaxtwin.simulation._workers import work_in_chunks


@pytest.mark.parametrize(
    ("count", "sizes"),
    [(3, [4]), (20, [64]), (64, [64]), (100, [64] * 2), (128, [64] * 2), (129, [256]),
     (300, [256] * 2)],
)  # fmt: skip
def test_chunks_have_few_sizes_and_few_copies(count: int, sizes: list[int]):
    seen: list[int] = []

    def doubled(chunk):
        seen.append(len(chunk["x"]))
        return {"y": 2 * chunk["x"]}

    draws = {"x": np.arange(float(count))}
    result = work_in_chunks(draws, doubled, chunk_size=256, workers=1)
    assert seen == sizes
    np.testing.assert_array_equal(result["y"], 2 * draws["x"])

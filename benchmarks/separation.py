"""How soon does a designed test tell four faults apart?

A gain and an offset of the sensor, a higher resistance and more losses of the first heater of
`tclab`: by the designed schedule, the best constant duty, and a pseudo-random binary sequence, in
ten minutes. And two faults that nothing tells apart: a weak supply and a heater of a higher
resistance.

    python -m benchmarks.separation
"""

import math
import time

import jaxtwin as jt
from benchmarks._machine import processor
from benchmarks._results import parser_of
from benchmarks._tables import table

FOUR = ("gain T1", "offset T1", "age H1", "leak H1")
ALIKE = ("weaken H1", "age H1")
DURATION, HOLD, LEVELS = 600, 60, 3


def main() -> None:
    given = parser_of(__doc__).parse_args()
    rows = []
    for faults in (FOUR, ALIKE):
        began = time.process_time()
        found = jt.design_experiment(
            jt.Twin("tclab"),
            purpose="diagnosis",
            faults=list(faults),
            duration=DURATION,
            hold=HOLD,
            levels=LEVELS,
        )
        cpu = time.process_time() - began
        others = {name: each.separation for name, each in found.references.items()}
        rows.append((
            ", ".join(faults), seconds(found.best.separation),
            *(seconds(one) for one in others.values()), f"{cpu:.0f}",
        ))  # fmt: skip
        head = ("faults", "designed", *others, "CPU time of the design, s")
    page = (
        "# A test that tells faults apart\n\n"
        f"{processor()}; `python -m benchmarks.separation`. After how many seconds the mean odds "
        f"of any two of the faults of `tclab` have passed 20 to 1, in {DURATION} s with steps of "
        f"{HOLD} s and {LEVELS} levels. [Experiment design]"
        "(../../docs/experiment-design.md#a-test-that-tells-faults-apart) says what follows.\n\n"
        + table(head, rows)
    )
    (given.out / "separation.md").write_text(page)
    print(page)


def seconds(time: float) -> str:
    """A time; none that is not reached."""
    return f"{time:.0f}" if math.isfinite(time) else "never"


if __name__ == "__main__":
    main()

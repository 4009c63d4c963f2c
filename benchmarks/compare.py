"""The whole comparison in one process run: a table, a plot and the numbers.

python -m benchmarks.compare [--quick] [--out FOLDER]
"""

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

from . import matching, scaling, ways
from ._machine import machine
from ._pictures import speed_picture
from ._results import parser_of
from ._tables import results_page

QUESTIONS: dict[str, Callable[[bool], Any]] = {
    "ways": ways.measure,
    "scaling": scaling.measure,
    "matching": matching.measure,
}


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--quick", action="store_true", help="small: whether it runs at all")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {"machine": machine(), "quick": options.quick}
    for name, measure in QUESTIONS.items():
        began = time.perf_counter()
        results[name] = measure(options.quick)
        print(f"{name}: {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
        # Kept as it grows: what is measured is not lost where a later question fails.
        (options.out / "results.json").write_text(json.dumps(results, indent=1) + "\n")
    results["machine"]["load_after"] = round(os.getloadavg()[0], 2)
    (options.out / "results.json").write_text(json.dumps(results, indent=1) + "\n")
    (options.out / "draws_a_second.png").write_bytes(speed_picture(results["scaling"]["times"]))
    page = results_page(results)
    (options.out / "results.md").write_text(page)
    print(page)


if __name__ == "__main__":
    main()

"""Do the properties of the parsers hold for many more examples than the tests try?

    python benchmarks/live_properties.py --seconds 600

Takes the hypothesis tests of framing and messages from tests/live, and runs them again and again
with new random examples until the time is over. A failure ends it with the smallest example.
Prints one line of JSON.
"""

import argparse
import importlib
import json
import resource
import sys
import time
from pathlib import Path

import hypothesis
from hypothesis import HealthCheck

EXAMPLES = 2000
"""Of one property in one turn."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    options = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "live"))
    modules = [importlib.import_module(name) for name in ("test_framing", "test_messages")]
    many = hypothesis.settings(
        max_examples=EXAMPLES,
        deadline=None,
        database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    properties = [
        many(function)
        for module in modules
        for function in vars(module).values()
        if hypothesis.is_hypothesis_test(function)
    ]
    begin = time.monotonic()
    turns = 0
    while time.monotonic() - begin < options.seconds:
        for function in properties:
            function()
        turns += 1
    result = {
        "seconds": round(time.monotonic() - begin),
        "properties": len(properties),
        "examples": turns * EXAMPLES * len(properties),
        "peak memory, MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()

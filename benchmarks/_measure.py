"""Times that can be compared: medians over rounds in which every way has its turn."""

import argparse
import importlib
import json
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from statistics import median
from typing import Any, TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def rounds(
    ways: Mapping[str, Callable[[], object]], count: int, warm: bool = False
) -> dict[str, list[float]]:
    """Wall times in s of each way, one a round.

    What else the machine does falls on all ways of a round alike, so that ratios within a round
    hold where times do not.

    **Arguments:**

    - `warm`: whether a way runs once more before it is timed. What the way before it freed is
      given back to the system, and fresh pages can cost a way with large results as much as its
      own work.
    """
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(count):
        for name, way in ways.items():
            if warm:
                way()
            began = time.perf_counter()
            way()
            times[name].append(time.perf_counter() - began)
    return times


def median_ratio(times: list[float], reference: list[float]) -> float:
    """The median over rounds of one way's time over another's."""
    return median(own / other for own, other in zip(times, reference, strict=True))


def warm_median(way: Callable[[], object], count: int) -> float:
    """Median wall time in s of repeated calls, after one that does not count."""
    way()
    return median(rounds({"": way}, count)[""])


def on_all_cores(function: Callable[[Job], Result], jobs: Iterable[Job]) -> list[Result]:
    """What a function gives for each job, a process a core; no time is taken meanwhile."""
    # Not forked: JAX has threads.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=context) as pool:
        return list(pool.map(function, jobs))


def in_fresh_process(case: str, *arguments: Any, environment: Mapping[str, str] = {}) -> Any:
    """Runs `module:function` of this package with JSON arguments in a process of its own.

    **Returns:** what the function returns, through JSON.
    """
    command = [sys.executable, "-m", "benchmarks._measure", case, json.dumps(arguments)]
    # What the function itself prints goes to standard error.
    done = subprocess.run(
        command, env=os.environ | environment, stdout=subprocess.PIPE, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def run_alone(measure: Callable[[bool], Any], purpose: str | None) -> None:
    """The command line of a single question: prints its answer as JSON."""
    parser = argparse.ArgumentParser(
        description=purpose, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small: whether it runs at all")
    print(json.dumps(measure(parser.parse_args().quick), indent=1))


def _main() -> None:
    module, function = sys.argv[1].split(":")
    answer = getattr(importlib.import_module(f"benchmarks.{module}"), function)(
        *json.loads(sys.argv[2])
    )
    print(json.dumps(answer))


if __name__ == "__main__":
    _main()

"""What does a single bad reading do to a match, an observer and a monitor?

    python -m benchmarks.glitches [--seeds 50]

For each of four rigs, a simulated recording with the noise of the rig's sensors gets one bad
reading a seed: a code of a sensor or logger, or an offset of 5 to 50 K, in a random channel at a
random sample, also the first and the last. Counted are

- those that the recording names (`Experiment.glitches`), and readings that it names wrongly,
- the largest change of a matched parameter by a glitch that is left out, in standard errors,
- the largest difference of the observer's expectation from that without the glitch, two samples
  later and from then on, K,
- the findings of the monitor that a glitch adds, and those of them that are no single notice.
"""

import argparse
import time
from collections import Counter
from dataclasses import replace

import numpy as np

import jaxtwin as jt

RIGS = {
    "tclab": ("0:0.3,300:0.6,600:0.2", 900),
    "single-cell": ("0:0.3,300:0.6,600:-0.2", 900),
    "dual-cell": ("0:0.3,300:0.6,600:-0.2", 900),
    "heated-box": ("0:1,900:0,1800:1", 2700),
}
"""Rig -> duty of all actuators, and duration, s."""

CODES = (-127.0, 85.0, 0.0, 9999.0)


def glitched(recording: jt.Experiment, seed: int) -> tuple[jt.Experiment, int, int]:
    """A recording with a bad reading, and its row and column."""
    random = np.random.default_rng(seed)
    readings = np.array(recording.temperatures)
    row = (0, len(readings) - 1)[seed % 2] if seed < 4 else int(random.integers(len(readings)))
    column = int(random.integers(readings.shape[1]))
    offset = random.choice([-1, 1]) * random.uniform(5.0, 50.0)
    value = random.choice([*CODES, readings[row, column] + offset], p=[0.1] * 4 + [0.6])
    if abs(value - readings[row, column]) < 5.0:  # a code that could be a temperature
        value = readings[row, column] + offset
    readings[row, column] = value
    return replace(recording, temperatures=readings), row, column


def row_of(name: str, seeds: int) -> list[str]:
    duty, duration = RIGS[name]
    twin = jt.Twin(name)
    plan = jt.Experiment.schedule(duty, duration=duration, cells=len(twin.rig.driven))
    recording = twin.simulate(plan).to_recording(seed=0)
    clean = jt.match(twin, [recording])
    observed = jt.observe(clean, recording)
    usual = Counter(each.kind for each in jt.monitor(clean, recording).findings)
    named = wrong = extra = missed = 0
    moved = later = 0.0
    for seed in range(seeds):
        bad, at, column = glitched(recording, seed)
        places = [(each.time, each.channel) for each in bad.glitches]
        is_named = (float(bad.time[at]), bad.channels[column]) in places
        named, wrong = named + is_named, wrong + len(places) - is_named
        fit = jt.match(twin, [bad.without_glitches()])
        moves = [
            abs(fit[key].value - each.value) / each.standard_error
            for key, each in clean.parameters.items()
            if each.free and each.standard_error > 0
        ]
        moved = max(moved, *moves)
        after = jt.observe(clean, bad).expected.mean[at + 2 :]
        if len(after):
            apart = np.abs(after - observed.expected.mean[at + 2 :])
            later = max(later, float(apart.max()))
        found = Counter(each.kind for each in jt.monitor(clean, bad).findings)
        new = found - usual
        impossible = new.pop("impossible", 0)
        extra += new.total()
        # Of the last reading nobody knows yet whether it lasts.
        missed += impossible != 1 and at < len(bad.time) - 1
    return [
        name,
        str(seeds),
        str(named),
        str(wrong),
        f"{moved:.2f}",
        f"{later:.3f}",
        str(extra),
        str(missed),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--rig", choices=list(RIGS), action="append")
    options = parser.parse_args()
    head = ["rig", "glitches", "named", "named wrongly", "parameter moved, s.e."]
    head += ["observer off two samples later, K", "other findings", "without a finding"]
    print(f"| {' | '.join(head)} |\n{'|---' * len(head)}|")
    for name in options.rig or RIGS:
        begin = time.process_time()
        print(f"| {' | '.join(row_of(name, options.seeds))} |", flush=True)
        print(f"<!-- {time.process_time() - begin:.0f} s of CPU -->", flush=True)


if __name__ == "__main__":
    main()

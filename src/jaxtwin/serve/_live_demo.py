"""A scripted story on a virtual rig: steps, a contact that comes loose, the finding, the diagnosis,
the refit, the promotion, and a rig that is well again with a twin that knows it."""

import re
from dataclasses import replace
from pathlib import Path
from typing import final

import numpy as np

from ..io import Experiment
from ..live import Reading, Record, RigState, Sample
from ..live.protocol._clock import seconds
from ..matching import match
from ..observers._observe import usual_noise
from ..physics import Faults, Twin
from ..rig import CellPlace, Rig, new_rig_text
from ..rig._build import parse_rig
from ..simulation import simulate
from ..twin_store import TwinStore
from ._desk import Desk, DriveOrder, RefitOrder
from ._page import Page
from ._rig_loop import STOPPED_BY_HAND

SESSION, SESSIONS = 900, 4
"""The length of a session from which the first twin is matched, s, and their number."""

# The time between two steps of the duty, s of the rig.
STEP_SECONDS = 60.0

# How long an order holds its duty, s of the rig. It is checked before it is obeyed, while the rig
# waits: a day of a plate takes several seconds.
HELD_SECONDS = 600.0

# When the contact comes loose, s of the rig.
LOOSE_AT = 360.0

# The step of the duty, from 1 on, at which the cells rest.
REST_STEP = round(LOOSE_AT / STEP_SECONDS) + 2

# The time from its end to which the twin is refitted, s of the rig, and how much of the rest
# belongs to it. Only at the end of a rest do the temperatures at the start describe the rig, whose
# cell and plate differ by several K while heat flows through the loose contact.
REFIT_SECONDS, REST_SECONDS = 480.0, 5.0

# The longest time between two samples in which a change of the duty has its place, s of the host.
MAX_SILENCE_SECONDS = 0.4

# How late a command may reach the rig, s of the host.
MAX_LATENESS_SECONDS = 0.1

# The lowest and the highest duty of the steps.
DUTY = (0.0, 0.5)


def demo_rig() -> Rig:
    """The rig of the story: a plate of two cells, as `jaxtwin new-rig` writes it."""
    text = new_rig_text(
        "two-cells", width="12 cm", height="4 cm", thickness="2 mm", material="aluminium",
        module="TEC1-12706", places=[CellPlace("3 cm", "2 cm"), CellPlace("9 cm", "2 cm")],
        zones=(6, 2),
    )  # fmt: skip
    titled = re.sub("^title = .*$", 'title = "A plate of two cells"', text, flags=re.MULTILINE)
    return parse_rig(titled.encode(), "the rig of the demo")


def demo_faults() -> Faults:
    """The fault of the story: the resistance of a cell's contact is three times what it was."""
    return Faults.parse(f"loosen=P1@{LOOSE_AT:g}/3")


def demo_store(rig: Rig, folder: Path, speed: float | int, seed: int = 0) -> TwinStore:
    """Makes a store whose champion is matched to simulated sessions of the rig.

    **Arguments:**

    - `rig`: the rig. `folder`: where the file of the store is made.
    - `speed`: the seconds of the virtual rig in a second.
    - `seed`: the seed of duty and noise.
    """
    twin, random = Twin(rig), np.random.default_rng(seed)
    sessions = []
    for number in range(SESSIONS):
        steps = random.uniform(*DUTY, (SESSION // int(STEP_SECONDS) + 1, len(twin.rig.driven)))
        duty = np.repeat(steps, int(STEP_SECONDS), axis=0)[: SESSION + 1]
        plan = Experiment(np.arange(SESSION + 1.0), duty, channels=twin.channels)
        run = simulate(twin, plan)
        sessions.append(run.to_recording(seed=seed + number, name=f"session {number + 1}"))
    store = TwinStore(folder / "demo.db")
    fit = match(twin, sessions)
    noise = usual_noise(fit, sessions)
    # The faster a rig runs, the later in its own time a command reaches it.
    late = max(float(np.asarray(noise.command_time)), MAX_LATENESS_SECONDS * speed)
    noise = replace(noise, command_time=late)
    store.add(fit, reason="matched to four sessions", noise=noise, aliases=["champion"])
    return store


@final
class DemoScript:
    """Drives the rig by steps and has the twin refitted, at the times of the rig. It consumes the
    records of a source. Once somebody has stopped the rig, it leaves it alone.

    **Arguments:**

    - `desk`: where it leaves its orders, as clients do.
    - `page`: the page, whose log tells the story.
    - `seed`: the seed of the duty.
    """

    def __init__(self, desk: Desk, page: Page, seed: int = 1):
        self._desk, self._page = desk, page
        self._random = np.random.default_rng(seed)
        self._first_twin = page.followed[1]  # which does not know the loose contact
        self._first: int | None = None
        self._time, self._steps = 0.0, 0
        self._rest_step = REST_STEP
        self._is_idle, self._is_unsure = True, False
        self._sample: tuple[int, tuple[int, ...]] | None = None  # host time, ns, and counts
        self._told: set[str] = set()

    def on_record(self, record: Record, state: RigState) -> None:
        """Follows the time of the rig."""
        if isinstance(record, Reading):
            now = state.time_of(record)
            self._first = now if self._first is None else self._first
            self._time = seconds(now - self._first) * state.rate
        elif isinstance(record, Sample) and record.pwm:
            now, before = state.time_of(record), self._sample
            if before is not None and before[1] != record.pwm:
                self._is_unsure |= seconds(now - before[0]) > MAX_SILENCE_SECONDS
            self._sample = now, record.pwm

    def on_time(self, state: RigState, now: int) -> None:
        """Leaves the orders that are due."""
        run = self._page.ring.newest_of("run")
        if self._first is None or run["text"].startswith(STOPPED_BY_HAND):
            return
        if self._time >= STEP_SECONDS * self._steps:
            self._steps += 1
            cells = len(self._page.twin.rig.driven)
            duty = np.round(self._random.uniform(*DUTY, cells), 2)
            if self._steps == self._rest_step:
                duty = np.zeros(cells)
            # An interlock may have ended the run, on a machine that was busy with other things.
            self._desk.ask(DriveOrder(tuple(duty.tolist()), HELD_SECONDS, reset=self._steps > 1))
        if self._time >= LOOSE_AT:
            self._tell("the contact of the cell comes loose now; see who notices")
        was_idle, self._is_idle = self._is_idle, run["state"] == "idle"
        if self._is_unsure or (self._is_idle and not was_idle):
            # Nothing was heard when the duty changed, or an interlock has ended the run: the duty
            # is not known well enough. The time to which the twin is refitted begins anew.
            self._rest_step, self._is_unsure = max(REST_STEP, self._steps + 1), False
        is_due = self._time >= STEP_SECONDS * self._rest_step + REFIT_SECONDS
        if is_due and self._tell("the twin learns the loose contact"):
            self._desk.ask(RefitOrder(REFIT_SECONDS + REST_SECONDS))
        story = self._page.ring.newest_of("story")
        if (
            self._page.followed[1] != self._first_twin
            and story
            and story["twin"]["level"] == "good"
        ):
            self._tell(
                "the twin has learned the loose contact and is right again: the loop is closed"
            )

    def _tell(self, text: str) -> bool:
        """Says something once. Returns whether it was said now."""
        if text in self._told:
            return False
        self._told.add(text)
        self._page.say("notice", f"demo: {text}")
        return True

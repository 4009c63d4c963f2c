"""A scripted story on a virtual rig: a loop that holds a plate even, a contact that comes loose,
the finding, the diagnosis, the refit, and a controller that is tuned on the new twin."""

import re
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import final

import numpy as np

from ..control import PID, ControllerDesign
from ..io import Experiment
from ..live import Reading, Record, RigState, Sample, seconds
from ..matching import match
from ..observers import usual_noise
from ..physics import Faults, Twin
from ..rig import CellPlace, Rig, new_rig_text, parse_rig
from ..simulation import simulate
from ..twin_store import TwinStore
from ._desk import Desk, HoldOrder, RefitOrder
from ._page import Page
from ._rig_loop import STOPPED_BY_HAND

SESSION, SESSIONS = 900, 4
"""The length of a session from which the first twin is matched, s, and their number."""

# In these sessions: the time between two steps of the duty, s, and its lowest and highest value.
STEP_SECONDS = 60
DUTY = (0.0, 0.5)

# By how much each value of the rig differs from one session to the next, as a part of it: a refit
# takes what is no more for drift.
DRIFT = 0.01

# The two references, degC, which alternate; and the time between two steps, s of the rig.
REFERENCES = (50.0, 45.0)
HELD_SECONDS = 120.0

# The temperature of the room in the rig file, degC.
ROOM = 20.0

# When the contact comes loose, s of the rig: at rest, so that nothing else changes.
LOOSE_AT = 200.0

# When the plate is brought to the temperature of the room, and for how long. Only there is known at
# which temperatures the time begins to which the twin is refitted: while heat flows through the
# loose contact, cell and plate differ by several K.
ROOM_AT, ROOM_SECONDS = 360.0, 150.0

# The time to which the twin is refitted, s of the rig, and the last part of the room's time, which
# belongs to it. A third of both is held out, two minutes at least.
REFIT_SECONDS, REST_SECONDS = 365.0, 5.0

# When it is refitted, s of the rig.
REFIT_AT = ROOM_AT + ROOM_SECONDS + REFIT_SECONDS

# For how long an order holds a reference, s of the rig: longer than until the next.
ORDER_SECONDS = 1200.0

# The longest time between two samples in which a change of the duty has its place, s of the host.
MAX_SILENCE_SECONDS = 0.4

# How late a command may reach the rig, s of the host.
MAX_LATENESS_SECONDS = 0.1

# A plate is even if its halves differ by less than this in the mean of half a minute, K; uneven, if
# they differ by more than twice as much.
EVEN_KELVIN, EVEN_SECONDS = 0.5, 30.0

# What is said when the twin is refitted.
REFITTED = "the twin learns the loose contact; then its controller is tuned"


def demo_rig() -> Rig:
    """The rig of the story: a plate of two cells, as `jaxtwin new-rig` writes it. It is held far
    above the room in a draught, so that much heat flows through the pads between it and its
    cells."""
    text = new_rig_text(
        "two-cells", width="12 cm", height="4 cm", thickness="3 mm", material="carbon-steel",
        module="TEC1-12706", places=[CellPlace("3 cm", "2 cm"), CellPlace("9 cm", "2 cm")],
        zones=(6, 2),
    )  # fmt: skip
    text = re.sub("^title = .*$", 'title = "A plate of two cells"', text, flags=re.MULTILINE)
    text = re.sub("^(h = { value =) 15.0", r"\1 60.0", text, flags=re.MULTILINE)
    # A pad of 1 mm with 2 W/(m K) under 16 cm^2 has 0.3 K/W; each cell touches 16 elements.
    pad = r'\1 5.0, unit = "K/W", bounds = [0.05, 500]'
    text = re.sub(r"^(R_pc_\d = { value =) .*\[0.005, 50\]", pad, text, flags=re.MULTILINE)
    return parse_rig(text.encode(), "the rig of the demo")


def demo_faults() -> Faults:
    """The fault of the story: the resistance of a cell's contact is 3.5 times what it was."""
    return Faults.parse(f"loosen=P1@{LOOSE_AT:g}/3.5")


def demo_controller() -> tuple[PID, ControllerDesign]:
    """The controller of the story, as `tune` finds it on the rig without a fault, and for what it
    is designed: to follow the references, and to keep the plate even."""
    low, high = sorted(REFERENCES)
    levels = (low, high, low, high)
    steps = ",".join(f"{HELD_SECONDS * step:g}:{level:g}" for step, level in enumerate(levels))
    objective = {"integral_absolute_error": 1.0, "plate_range_at_rest": 20.0}
    return (
        PID(Kp=[0.2, 0.2], Ki=[0.006, 0.006], limits=(-0.3, 0.5)),
        ControllerDesign(steps, HELD_SECONDS * len(levels), objective),
    )


def demo_store(rig: Rig, folder: Path, speed: float | int, seed: int = 0) -> TwinStore:
    """Makes a store whose champion is matched to simulated sessions of the rig.

    **Arguments:**

    - `rig`: the rig. `folder`: where the file of the store is made.
    - `speed`: the seconds of the virtual rig in a second.
    - `seed`: the seed of duty and noise.
    """
    twin, random = Twin(rig), np.random.default_rng(seed)
    shared = [name for name, row in rig.parameters.items() if row.free and row.scope == "shared"]
    sessions = []
    for number in range(SESSIONS):
        steps = random.uniform(*DUTY, (SESSION // STEP_SECONDS + 1, len(twin.rig.driven)))
        duty = np.repeat(steps, STEP_SECONDS, axis=0)[: SESSION + 1]
        plan = Experiment(np.arange(SESSION + 1.0), duty, channels=twin.channels)
        drift = np.exp(DRIFT * random.standard_normal(len(shared)))
        values = {name: twin.values[name] * part for name, part in zip(shared, drift, strict=True)}
        run = simulate(twin.with_values(values), plan)
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
    """Steps the references and has the twin refitted, at the times of the rig; what follows, the
    page does by itself. It consumes the records of a source. Once somebody has stopped the rig, it
    leaves it alone.

    **Arguments:**

    - `desk`: where it leaves its orders, as clients do.
    - `page`: the page, whose log tells the story.
    """

    def __init__(self, desk: Desk, page: Page):
        self._desk, self._page = desk, page
        columns = np.array([int(name[-1]) for name in page.twin.channels])
        self._is_left = columns <= np.median(columns)
        self._first: int | None = None
        self._time = self._shift = 0.0
        self._reference, self._stepped = np.nan, 0.0  # since when it is held, s of the rig
        self._is_idle, self._is_unsure = True, False
        self._sample: tuple[int, tuple[int, ...]] | None = None  # host time, ns, and counts
        # Times of the rig, s, and the difference between the halves of the plate, K.
        self._halves: deque[tuple[float, float]] = deque()
        self._told: set[str] = set()

    def on_record(self, record: Record, state: RigState) -> None:
        """Follows the time of the rig."""
        if isinstance(record, Reading):
            now = state.time_of(record)
            self._first = now if self._first is None else self._first
            self._time = seconds(now - self._first) * state.rate
            left, right = (record.temperatures[half] for half in (self._is_left, ~self._is_left))
            self._halves.append((self._time, float(np.nanmean(right) - np.nanmean(left))))
            while self._time - self._halves[0][0] > EVEN_SECONDS:
                self._halves.popleft()
        elif isinstance(record, Sample) and record.pwm:
            now, before = state.time_of(record), self._sample
            if before is not None and before[1] != record.pwm:
                self._is_unsure |= seconds(now - before[0]) > MAX_SILENCE_SECONDS
            self._sample = now, record.pwm

    def on_time(self, state: RigState, now: int) -> None:
        """Leaves the orders that are due, and tells the story."""
        run = self._page.ring.newest_of("run")
        if self._first is None or run["text"].startswith(STOPPED_BY_HAND):
            return
        was_idle, self._is_idle = self._is_idle, run["state"] == "idle"
        has_stopped = self._is_idle and not was_idle
        at = self._time - self._shift
        if (has_stopped or self._is_unsure) and at >= ROOM_AT and REFITTED not in self._told:
            # An interlock has ended the run, or the duty is not known well enough: the time to
            # which the twin is refitted begins anew.
            self._shift = self._time - ROOM_AT
            at = ROOM_AT
        self._is_unsure = False
        reference = reference_at(at)
        if reference != self._reference or has_stopped:
            self._desk.ask(HoldOrder((reference,), ORDER_SECONDS, reset=True))
            self._reference, self._stepped = reference, self._time
        if self._time >= LOOSE_AT:
            self._tell("the contact of P1 comes loose now; see who notices")
        if at >= ROOM_AT:
            self._tell("the plate is brought to the room, where a time begins that the twin knows")
        if at >= REFIT_AT and self._tell(REFITTED):
            self._desk.ask(RefitOrder(REFIT_SECONDS + REST_SECONDS))
        self._tell_evenness()

    def _tell_evenness(self) -> None:
        """Tells by the readings of a loop at rest whether the plate is uneven, and even again."""
        if self._time - self._stepped < HELD_SECONDS - EVEN_SECONDS or not self._halves:
            return
        unevenness = abs(float(np.mean([difference for _, difference in self._halves])))
        if unevenness > 2 * EVEN_KELVIN:
            self._tell("the loop is worse: its mean is held, but one half of the plate is colder")
        elif unevenness < EVEN_KELVIN and REFITTED in self._told:
            self._tell("the plate is even again: the controller was tuned on the twin that knows")

    def _tell(self, text: str) -> bool:
        """Says something once. Returns whether it was said now."""
        if text in self._told:
            return False
        self._told.add(text)
        self._page.say("notice", f"demo: {text}")
        return True


def reference_at(time: float | int) -> float:
    """The reference at a time of the story, degC."""
    if ROOM_AT <= time < ROOM_AT + ROOM_SECONDS:
        return ROOM
    begun, first = (0.0, 0) if time < ROOM_AT else (ROOM_AT + ROOM_SECONDS, 1)
    return REFERENCES[(first + int((time - begun) // HELD_SECONDS)) % len(REFERENCES)]

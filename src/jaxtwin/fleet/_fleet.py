"""The loop around a fleet: it reads the broker, keeps the journal, and steps all lanes."""

import contextlib
import hashlib
import json
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, final

import numpy as np

from .._executor import Executor
from ..errors import JaxtwinError
from ..live import Finding, finding_as_json
from ..serve._contents import look_ahead
from ..serve._live_diagnosis import MIN_SAMPLES, causes_of, refit_champion
from ..serve._story import Reason
from ..twin_store import TwinStore
from ._fleet_file import FleetFile, Member
from ._inbox import Inbox
from ._jobs import Done, Jobs
from ._journal import FleetJournal, Message
from ._lanes import LANES, Lanes, structure_of
from ._sample_queue import MAX_WAITING, ObserverStep
from ._watched_rig import WatchedRig, WatchedTwin, watched_twin

# The time between two turns of all lanes, s.
TICK_SECONDS = 1.0

# In a turn the lanes of a block take steps while this part of them has samples, and then a few for
# those that are left: a rig alone delays no other.
BUSY_FRACTION = 0.25
MAX_LATE_STEPS = 4

# While more samples than these wait for each rig, the broker keeps what comes.
MAX_BACKLOG = 20

# Fewer messages than these are waited for, so long, that more come with them: to take some costs as
# much as some more of them, s.
MANY_MESSAGES = 10
GATHER_SECONDS = 0.01

# The times between two looks at the files, two states of a rig in the journal, two forecasts, and
# two removals of old messages, s.
FILES_SECONDS = 5.0
STATE_SECONDS = 120.0
AHEAD_SECONDS = 5.0
FORGET_SECONDS = 1.0

# Alarms of one kind that more rigs than these raise in a turn are one for the alarm command.
MAX_SINGLE_ALARMS = 3

log = logging.getLogger("jaxtwin.fleet")


@final
class Fleet:
    """Watches the rigs of a file.

    **Arguments:**

    - `path`: the file, which is read again when it changes.
    - `on_alarm`: called with each alarm and the name of its rig; with several of one kind, once.
    - `executor`: does diagnoses and refits; None: a process of this machine.

    **Raises:** the errors of the file, and of those that it names.
    """

    def __init__(
        self,
        path: Path,
        on_alarm: Callable[[Finding, str], object] = lambda alarm, rig: None,
        executor: Executor | None = None,
    ):
        self.file = FleetFile.read(path)
        """What the file says."""
        self.rigs: dict[str, WatchedRig] = {}
        """Name -> rig."""
        self.problem = ""
        """What is wrong with a file that has changed; `""`: nothing."""
        self.turned = time.monotonic()
        """When the loop turned last, s of the monotonic clock."""
        self._path, self._on_alarm = path, on_alarm
        self._blocks: list[Lanes] = []
        self._free: dict[Any, list[tuple[Lanes, int]]] = {}
        self._journal = FleetJournal(self.file.journal)
        digest = hashlib.sha256(str(self.file.journal).encode()).hexdigest()[:16]
        self._inbox = Inbox(self.file, f"jaxtwin-fleet-{digest}")
        self._jobs = Jobs(executor)
        self._maker = ThreadPoolExecutor(1, thread_name_prefix="twins of a fleet")
        self._making: dict[str, Future[WatchedTwin]] = {}
        self._refused: dict[str, tuple[Any, str]] = {}
        self._alarms: list[tuple[str, Finding]] = []
        self._read = path.stat().st_mtime_ns
        self._due: dict[str, float] = {}
        self._turn = 0
        self._refits: list[str] = []
        self._lock = threading.Lock()
        made: dict[Member, WatchedTwin] = {}  # rigs that share all files share what is made of them
        for member in self.file.members.values():
            key = member._replace(name="", group="")
            if key not in made:
                made[key] = watched_twin(member)
            self._use(made[key]._replace(member=member))
        self._catch_up()
        self._listen()

    @property
    def is_connected(self) -> bool:
        """Whether the broker is there."""
        return self._inbox.is_connected

    @property
    def problems(self) -> list[str]:
        """What keeps the fleet, or some of its rigs, from being watched."""
        muted = [
            f"{rig} floods, and is not listened to for a minute" for rig in list(self._inbox.muted)
        ]
        refused = [why for _, why in list(self._refused.values())]
        return [
            problem for problem in (self._inbox.problem, self.problem, *refused, *muted) if problem
        ]

    def run(self, is_over: Callable[[], bool]) -> None:
        """Watches until it is to end, and keeps the states of all rigs then."""
        self.turned = time.monotonic()
        while not is_over():
            self.turn()
        self._keep_states(list(self.rigs.values()))

    def turn(self) -> None:
        """Takes messages until the next tick, and then steps all lanes."""
        end = self.turned + TICK_SECONDS
        self._receive(0.0)
        while (left := end - time.monotonic()) > 0:
            self._receive(min(left, 0.1))
        self.turned = max(end, time.monotonic() - TICK_SECONDS)
        self.step()
        self._look()

    def findings(self, rig: str, count: int) -> list[dict[str, Any]]:
        """The last findings of a rig, as JSON."""
        return self._journal.findings(rig, count)

    def ask_for_refit(self, rig: str) -> str:
        """Has the champion of a rig refitted to its last minutes. Another thread may ask.

        **Returns:** why not; `""` if it is done soon.
        """
        if self.rigs[rig].made.member.store is None:
            return f"{rig} has no store whose champion could be refitted"
        with self._lock:
            self._refits.append(rig)
        return ""

    def close(self) -> None:
        """Ends the connection, the work for rigs, and the journal."""
        self._inbox.close()
        self._jobs.close()
        self._maker.shutdown(wait=True, cancel_futures=True)
        self._journal.close()

    def step(self, *, is_all: bool = False) -> None:
        """Takes the steps for which samples wait; `is_all`: those of all samples."""
        members: dict[int, list[WatchedRig]] = {}
        for rig in self.rigs.values():
            members.setdefault(id(rig.lanes), []).append(rig)
        for block in self._blocks:
            rigs = members.get(id(block), [])
            late = 0
            while late < MAX_LATE_STEPS or is_all:
                waiting = [rig for rig in rigs if len(rig.queue)]
                if not waiting:
                    break
                late += len(waiting) < BUSY_FRACTION * len(rigs)
                late += MAX_LATE_STEPS if self._step(block, waiting) and not is_all else 0

    def hear(self, messages: Iterable[Message]) -> None:
        """Takes messages that the journal has."""
        for message in messages:
            if (rig := self.rigs.get(message.rig)) is not None:
                rig.hear(message)

    def _receive(self, wait: float) -> None:
        """Takes messages into the journal and the queues, while not too many wait."""
        waiting = sum(len(rig.queue) for rig in self.rigs.values())
        if waiting > MAX_BACKLOG * len(self.rigs):
            self.step()
        taken = self._inbox.receive(wait)
        if not taken:
            return
        kept = self._journal.add(time.time_ns(), [message[:3] for message in taken])
        self._inbox.acknowledge(taken)
        self.hear(kept)
        if len(taken) < MANY_MESSAGES:
            time.sleep(GATHER_SECONDS)

    def _catch_up(self) -> None:
        """Goes on where the process before ended: with the messages since the kept states."""
        numbers: dict[str, int] = {}
        for rig in self.rigs.values():
            stored = self._journal.state(rig.name)
            if stored is not None:
                rig.resume(stored)
            # Of a rig without a state there are only the messages of its first minutes.
            numbers[rig.name] = 0 if stored is None else stored.content["queue"]["number"]
        while numbers:
            for name, number in list(numbers.items()):
                messages = self._journal.after(name, number, MAX_WAITING)
                for message in messages:
                    self.rigs[name].queue.put(message.kind, message.payload, message.number)
                    numbers[name] = message.number
                if not messages:
                    del numbers[name]
            self.step(is_all=True)
        self._tell()

    def _use(self, twin: WatchedTwin) -> None:
        """Gives a rig a lane, or the twin of its lane another one."""
        name = twin.member.name
        before, structure = self.rigs.pop(name, None), structure_of(twin.watcher)
        if before is not None:
            self._release(before)
        free = self._free.setdefault(structure, [])
        if not free:
            block = Lanes(twin.watcher)
            look_ahead(twin.watcher[0], block.kalman(0), block.none().duty[0])  # compiles
            self._blocks.append(block)
            free += [(block, lane) for lane in reversed(range(LANES))]
        block, lane = free.pop()
        block.put(lane, twin.watcher)
        rig = WatchedRig(twin, block, lane, self.file.silence, self._found)
        if before is not None:
            rig.lines.extend(before.lines)
            rig.history = before.history if rig.group == before.group else rig.history
            rig.queue.counts.update(before.queue.counts)
        # A new dictionary: other threads go through the old one.
        self.rigs = {**self.rigs, name: rig}

    def _release(self, rig: WatchedRig) -> None:
        self._free[rig.lanes.structure].append((rig.lanes, rig.lane))

    def _listen(self) -> None:
        self._inbox.listen({name: rig.made.member.sample_time for name, rig in self.rigs.items()})

    def _step(self, block: Lanes, rigs: list[WatchedRig]) -> bool:
        """Takes a step of each of some rigs; whether none of them has more than what has just
        come, which is left to the next tick."""
        steps, taken = block.none(), list[tuple[WatchedRig, ObserverStep]]()
        first = np.full(LANES, np.nan)
        for rig in rigs:
            step = rig.queue.next()
            if step is None:
                continue
            lane = rig.lane
            steps.moves[lane], steps.dt[lane], steps.elapsed[lane] = True, step.dt, step.elapsed
            steps.duty[lane], steps.ambient[lane] = step.duty, step.ambient
            if step.begins and step.readings is not None:
                first[lane] = np.nanmean(step.readings) if np.isfinite(step.readings).any() else 20
            if step.readings is not None:
                steps.readings[lane], steps.reads[lane] = step.readings, True
                taken.append((rig, step))
        if np.isfinite(first).any():
            block.begin(first, steps.duty, np.isfinite(first))
        result = block.step(steps)
        for rig, step in taken:
            lane = rig.lane
            if not result.is_finite[lane]:
                rig.diverge()
                continue
            evidence = type(result.evidence)(*(part[lane] for part in result.evidence))
            rig.take(step, evidence, result.expected[lane], result.whitened[lane])
        return all(len(rig.queue) < 2 for rig in rigs)

    def _look(self) -> None:
        """What is done from time to time."""
        now, rigs = time.monotonic(), self.rigs
        self._turn += 1
        for rig in rigs.values():
            rig.update_alarms(self._inbox.problem)
            if rig.due and rig.queue.time >= rig.due[0] * 1e9:
                self._diagnose(rig)
        self._tell()
        for done in self._jobs.take():
            self._finish(done)
        with self._lock:
            asked, self._refits = self._refits, []
        for name in asked:
            self._refit(rigs[name])
        if self._is_due("files", FILES_SECONDS, now):
            self._look_at_files()
        self._take_made()
        if self._is_due("ahead", AHEAD_SECONDS, now):
            self._look_ahead()
        parts = max(1, round(STATE_SECONDS / TICK_SECONDS))
        self._keep_states(list(rigs.values())[self._turn % parts :: parts])
        if self._is_due("forget", FORGET_SECONDS, now):
            self._journal.forget(time.time_ns() - round(self.file.keep_days * 86_400e9))

    def _look_ahead(self) -> None:
        """Forecasts of all rigs that have been read."""
        for block in self._blocks:
            duty = np.zeros_like(block.none().duty)
            rigs = [rig for rig in self.rigs.values() if rig.lanes is block]
            for rig in rigs:
                duty[rig.lane] = rig.queue.duty
            later = block.ahead(duty)
            for rig in rigs:
                rig.forecast(type(later)(later.mean[rig.lane], later.spread[rig.lane]))

    def _is_due(self, what: str, every: float, now: float) -> bool:
        if now < self._due.get(what, 0.0):
            return False
        self._due[what] = now + every
        return True

    def _keep_states(self, rigs: list[WatchedRig]) -> None:
        if rigs:
            self._journal.keep_states({rig.name: rig.stored() for rig in rigs})

    def _found(self, rig: WatchedRig, finding: Finding) -> None:
        if self._journal.find(rig.name, finding):
            self._alarms.append((rig.name, finding))

    def _tell(self) -> None:
        """Tells the findings of this turn: each to the broker, alarms to the alarm command."""
        told, self._alarms = self._alarms, []
        for name, finding in told:
            content = {"rig": name, "group": self.rigs[name].group, **finding_as_json(finding)}
            self._inbox.publish(self.file.topic(name, "alerts"), json.dumps(content))
        alarms = [(name, finding) for name, finding in told if finding.is_alarm]
        kinds = Counter(finding.kind for _, finding in alarms)
        for kind, count in kinds.items():
            of_kind = [alarm for alarm in alarms if alarm[1].kind == kind]
            names = ", ".join(name for name, _ in of_kind[:MAX_SINGLE_ALARMS])
            if count > MAX_SINGLE_ALARMS:
                detail = f"{count} rigs, such as {names}: {of_kind[0][1].detail}"
                self._on_alarm(Finding(kind, detail, severity=of_kind[0][1].severity), "")
                continue
            for name, finding in of_kind:
                self._on_alarm(finding, name)

    def _diagnose(self, rig: WatchedRig) -> None:
        rig.due = [at for at in rig.due if rig.queue.time < at * 1e9]
        twin, noise = rig.made.twin, rig.made.noise

        def arguments() -> tuple[Any, ...]:
            recorded = rig.recorded(self._journal)
            if len(recorded.time) < MIN_SAMPLES:
                raise JaxtwinError(f"expected {MIN_SAMPLES} samples, got {len(recorded.time)}")
            return twin, recorded, noise

        if self._jobs.begin(rig.name, "diagnosis", causes_of, arguments):
            rig.diagnosis = {**rig.diagnosis, "state": "running"}

    def _refit(self, rig: WatchedRig) -> None:
        store = rig.made.member.store
        assert store is not None
        self._jobs.begin(
            rig.name, "refit", refit_champion,
            lambda: (TwinStore(store), rig.recorded(self._journal)),
        )  # fmt: skip

    def _finish(self, done: Done) -> None:
        rig = self.rigs.get(done.rig)
        if rig is None:
            return
        if done.kind == "refit":
            self._say(rig, f"refit: {done.problem or done.value}")
            return
        if done.problem:
            rig.diagnosis = {"state": "failed", "text": done.problem, "causes": []}
            return
        for cause in done.value:
            for explanation in cause["explanations"]:
                explanation["onset"] = rig.recorded_since + explanation["onset_s"]
        rig.diagnosis, rig.cause = {"state": "done", "causes": done.value}, None
        if done.value:
            cause = done.value[-1]
            best, until = cause["explanations"][0], cause["until_s"]
            ended = None if until is None else rig.recorded_since + until
            rig.cause = Reason(best["phrase"], best["probability"], best["onset"], ended)
            rig.fault = best["name"]
            self._say(rig, f"most likely (estimate): {rig.cause}")

    @staticmethod
    def _say(rig: WatchedRig, text: str) -> None:
        rig.lines.append({"t": time.time(), "level": "notice", "text": text})

    def _look_at_files(self) -> None:
        """Reads the file again if it has changed, and makes the twins of rigs whose files have."""
        with contextlib.suppress(FileNotFoundError):
            if (changed := self._path.stat().st_mtime_ns) != self._read:
                self._read = changed
                self._read_again()
        for name, member in self.file.members.items():
            rig, files = self.rigs.get(name), member.files
            is_same = rig is not None and rig.made.member == member and rig.made.files == files
            is_refused = self._refused.get(name, (None, ""))[0] == (member, files)
            if not (is_same or is_refused or name in self._making):
                self._making[name] = self._maker.submit(watched_twin, member)

    def _read_again(self) -> None:
        try:
            file = FleetFile.read(self._path)
        except JaxtwinError as problem:
            self.problem = str(problem)
            return
        fixed = ("url", "pattern", "journal", "dask")
        if changed := [
            field for field in fixed if getattr(file, field) != getattr(self.file, field)
        ]:
            name = {"url": "broker"}.get(changed[0], changed[0])
            self.problem = f"{self._path}: {name}: this change needs a new start of the fleet"
            return
        self.problem, self.file = "", file
        gone = [name for name in self.rigs if name not in file.members]
        self._keep_states([self.rigs[name] for name in gone])
        for name in gone:
            self._release(self.rigs[name])
        self.rigs = {name: rig for name, rig in self.rigs.items() if name not in gone}
        self._refused = {
            name: entry for name, entry in self._refused.items() if name in file.members
        }
        self._listen()

    def _take_made(self) -> None:
        """Goes on with the twins that were made meanwhile."""
        ready = [name for name, future in self._making.items() if future.done()]
        for name in ready:
            future, member = self._making.pop(name), self.file.members.get(name)
            if member is None:
                continue
            try:
                twin = future.result()
            except JaxtwinError as problem:
                self._refused[name] = (member, member.files), f"{name}: {problem}"
                continue
            self._refused.pop(name, None)
            before = self.rigs.get(name)
            self._use(twin)
            if before is not None:
                self._say(self.rigs[name], f"the twin is {twin.label} from now on")
            elif (stored := self._journal.state(name)) is not None:
                self.rigs[name].resume(stored)
        if ready:
            self._listen()

"""Forty ways in which a heated rig goes wrong, put between a virtual rig and its host.

Each hazard says what must stop the rig, and within what time the cells must be off: by the device's
own pins, not by what it reports. Time is the clock's of the test; nothing waits.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, final
from unittest.mock import patch

import jax
import numpy as np
from hand_clock import START, HandClock, stepped_bench

from jaxtwin.control import PID, LiveLoop, control, read_controller, save_controller
from jaxtwin.errors import JaxtwinError, SafetyStop
from jaxtwin.io import Experiment
from jaxtwin.live import (
    Data,
    Duty,
    Ending,
    Guard,
    Image,
    InProcess,
    Moment,
    Order,
    RigConnection,
    VirtualRig,
    deframe,
    drive,
    encode,
    operate,
    parse,
)
from jaxtwin.physics import Twin

Messages = list[Any]


@final
@dataclass
class Scene:
    """A run that goes wrong: what the injector may look at and change."""

    device: VirtualRig
    clock: HandClock
    random: np.random.Generator
    onset: float
    room: float
    is_measured: bool
    bench: RigConnection | None = None
    limit: float = np.inf
    lasts: float = 120.0
    draws: Mapping[str, np.ndarray] | None = None
    memory: dict[str, Any] = field(default_factory=dict)

    @property
    def time(self) -> float:
        """Since the beginning, s."""
        return (self.clock.now() - START) * 1e-9

    @property
    def given(self) -> float | None:
        """What the operator says of a room that the rig does not measure: nothing if it is near
        the 16 degC of the rig file, with or without a warm plate."""
        return self.room if not self.is_measured and not 11 < self.room < 16 else None

    @property
    def on(self) -> bool:
        """Whether it has begun to go wrong."""
        return self.time >= self.onset

    @property
    def hottest(self) -> float:
        """The hottest element of the plate, degC."""
        plant = self.device.twin
        return float(plant.nodes[: plant.system.wiring.elements].max())

    @property
    def since(self) -> float:
        """Since it has, s."""
        return self.time - self.onset


@final
@dataclass(frozen=True)
class Hazard:
    """One way to go wrong.

    - `kinds`: what may be the reason of the stop.
    - `bound`: in which time the cells must be off, s.
    - `spoken`: changes what the device says; `heard`: what it hears.
    - `happens`: called with each read, for what is neither.
    - `sensors`: on the rig without a camera.
    - `limits`: of the rig file, changed; rises above the room, K.
    - `begins`: when the danger is there, where that is not the onset.
    - `heats`: whether the duty must heat for long enough to warm the plate.
    - `lasts`: how long the run is, s.
    """

    name: str
    kinds: tuple[str, ...]
    bound: float
    spoken: Callable[[Scene, Messages], Messages] | None = None
    heard: Callable[[Scene, Messages], Messages] | None = None
    happens: Callable[[Scene], None] | None = None
    sensors: bool = False
    limits: dict[str, float] = field(default_factory=dict)
    begins: Callable[[Scene], bool] | None = None
    heats: bool = False
    lasts: float = 120.0


class Ran(NamedTuple):
    """How a run ended.

    - `off_after`: how long after the danger came the cells were on, s.
    - `reason`, `detail`: why it stopped, in a word and as it was said.
    - `hottest`: the temperature that the plate really reached, degC. `limit`: that of the rig.
    """

    off_after: float
    reason: str
    detail: str
    hottest: float
    limit: float


@final
class FaultyTransport:
    """A connection to a virtual rig, with a hazard in between."""

    def __init__(self, scene: Scene, hazard: Hazard):
        self._scene, self._hazard = scene, hazard
        self._inner = InProcess(scene.device, scene.clock)
        self._rest = b""

    def read(self) -> bytes:
        scene, hazard = self._scene, self._hazard
        if hazard.happens is not None and scene.on:
            hazard.happens(scene)
        if hazard.begins is not None and "begin" not in scene.memory and hazard.begins(scene):
            scene.memory["begin"] = scene.time
        data = self._inner.read()
        hottest = max(scene.memory.get("hottest", -np.inf), scene.hottest)
        scene.memory["hottest"] = hottest
        spoken = hazard.spoken if scene.on else None
        if spoken is None and scene.is_measured:
            return data
        frames, self._rest, _ = deframe(self._rest, data)
        said: Messages = [parse(frame) for frame in frames]
        if not scene.is_measured:
            said = [replace(m, ambient=None) if isinstance(m, Data) else m for m in said]
        if spoken is not None:
            said = spoken(scene, said)
        return b"".join(part if isinstance(part, bytes) else encode(part) for part in said)

    def write(self, data: bytes) -> None:
        self._scene.memory["hears"] = True
        self._write(data)
        self._scene.memory["hears"] = False

    def _write(self, data: bytes) -> None:
        scene, hazard = self._scene, self._hazard
        if hazard.heard is None or not scene.on:
            self._inner.write(data)
            return
        frames, _, _ = deframe(b"", data)
        for message in hazard.heard(scene, [parse(frame) for frame in frames]):
            self._inner.write(encode(message))

    def close(self) -> None:
        self._inner.close()


def run_hazard(
    hazard: Hazard,
    twins: Sequence[Twin],
    seed: int,
    controller: Path | None = None,
    truth: Mapping[str, float] = MappingProxyType({}),
    draws: Mapping[str, np.ndarray] | None = None,
) -> Ran:
    """Drives or controls a virtual rig until it is stopped, with everything that chance may choose:
    the room, whether the rig measures it, and how warm the rig is at the start among them.

    **Arguments:**

    - `hazard`: what goes wrong.
    - `twins`: of the rig with a camera, and of the one without.
    - `seed`: of noise, duty or references, onset and the pace of the host.
    - `controller`: a file of `save_pid`, for `control`; None: `drive` commands, by a schedule.
    - `truth`: values of the rig that its twin does not know.
    - `draws`: of what the twin's match does not know; None: the twin has not been matched.
    """
    random = np.random.default_rng(seed)
    room, warm = random.uniform(5, 40), random.choice([0.0, random.uniform(-5, 10)])
    twin = twins[hazard.sensors]
    if hazard.limits:
        assert twin.rig.limits is not None
        limits = {name: rise + room + 273.15 for name, rise in hazard.limits.items()}
        rig = replace(twin.rig, limits=replace(twin.rig.limits, **limits))
        twin = Twin(rig, dict(twin.values))
    clock = HandClock()
    real = Twin(twin.rig, {**twin.values, **truth, "T_amb": room})
    device = VirtualRig(real, seed=seed, camera_rate=random.uniform(4, 9))
    nodes = np.full(len(device.twin.nodes), room)
    nodes[: twin.wiring.elements] += warm
    device.twin.start(0.0, nodes)
    scene = Scene(device, clock, random, random.uniform(4, 12), room, random.random() < 0.5)
    assert twin.rig.limits is not None
    scene.limit, scene.draws = twin.rig.limits.temperature - 273.15, draws
    scene.lasts = hazard.lasts
    _watch_the_cells(scene)
    opener = lambda: FaultyTransport(scene, hazard)  # noqa: E731
    bench = stepped_bench(twin.rig, {"rig": opener}, clock, step=random.uniform(0.02, 0.1))
    scene.bench = bench
    reason, detail = "completed", ""
    try:
        command = driven if controller is None else controlled(controller)
        reason = command(scene, bench, twin, hazard.heats)
    except SafetyStop as stop:
        reason, detail = stop.kind, str(stop)
    except JaxtwinError as error:
        reason, detail = "error", str(error)
    except RuntimeError as error:
        reason, detail = "exception", str(error)
    # Nobody commands any more: what is on now, only the device can switch off.
    while any(device.pwm) and scene.since < 200:
        clock.turn(0.05)
        device.due(clock.now())
    reached = scene.memory.get("hottest", room), scene.limit
    if hazard.begins is not None and "begin" not in scene.memory:
        return Ran(0.0, reason, detail, *reached)  # the cells were off before
    begin = scene.memory.get("begin", scene.onset)
    off_at = scene.time if any(device.pwm) else scene.memory.get("off", begin)
    return Ran(max(0.0, off_at - begin), reason, detail, *reached)


def driven(scene: Scene, bench: RigConnection, twin: Twin, heats: bool) -> str:
    """`drive`: two duties for each cell, which change 0.7 s after the onset."""
    duty = scene.random.uniform(0.7 if heats else 0.4, 0.9, 4)
    duty[3] *= 1 if heats else -1
    schedule = f"0:{duty[0]:.2f}/{duty[1]:.2f},{scene.onset + 0.7:.2f}:{duty[2]:.2f}/{duty[3]:.2f}"
    plan = Experiment.schedule(schedule, duration=scene.lasts, cells=2)
    guard = Guard.of(twin, ambient=scene.given, draws=scene.draws)
    with _failing("jaxtwin.live._operate.operate", scene, lambda source: None):
        return drive(bench, guard, plan, accept=True)


def save_pid(file: Path, twin: Twin) -> Path:
    """A controller file: each cell holds its end of the plate. Its limits are below full duty, so
    that a bridge that runs away is seen."""
    measured = [["T11", "T21", "TAM"], ["T16", "T26", "TCM"]]
    pid = PID(0.1, 0.001, limits=(-0.9, 0.9), sample_time_s=0.25, measured=measured)
    save_controller(file, pid, twin.rig)
    return file


def controlled(controller: Path) -> Callable[[Scene, RigConnection, Twin, bool], str]:
    """`control` by a file: two references for each end of the plate, which change 0.4 s after the
    onset. The duty follows at the next sample."""

    def command(scene: Scene, bench: RigConnection, twin: Twin, heats: bool) -> str:
        hot = scene.room + scene.random.uniform(13, 15, 2)
        # Both ends reach these at the same time: cell 2 cools against what cell 1 heats.
        warm, cool = scene.room + scene.random.uniform([9, 2], [10, 3])
        if heats:
            (warm, cool) = hot = scene.room + scene.random.uniform(14, 15, 2)
        references = f"0:{hot[0]:.1f}/{hot[1]:.1f},{scene.onset + 0.4:.2f}:{warm:.1f}/{cool:.1f}"

        pid = read_controller(controller, twin.rig)
        # What can be reached depends on the room.
        loop = LiveLoop(twin, pid, references, duration=scene.lasts, ambient=scene.room)

        def spoil(_: Any) -> None:
            """The controller's own numbers are lost, and so is what it asks for."""
            loop._state = jax.tree.map(lambda part: part * np.nan, loop._state)

        with _failing("jaxtwin.control.loops._control.operate", scene, spoil):
            guard = Guard.of(twin, ambient=scene.room, draws=scene.draws)
            return control(bench, guard, loop, accept=True)

    return command


def _failing(where: str, scene: Scene, spoil: Callable[[Any], None]) -> Any:
    """Puts what a failing controller does in place of what `operate` asks there for the duty."""

    def operated(bench: RigConnection, guard: Guard, asked: Any, **options: Any) -> str:
        def source(moment: Moment) -> Sequence[float] | np.ndarray | None:
            failing = scene.memory.get("controller")
            if failing is None:
                return asked(moment)
            spoil(asked)
            return failing(moment, asked)

        return operate(bench, guard, source, **options)

    return patch(where, operated)


def _watch_the_cells(scene: Scene) -> None:
    """Notes when the cells are switched off: by a command now, or at the device's own time."""
    drive = scene.device.twin.drive

    def noted(duty: np.ndarray, ambient: float | None = None) -> None:
        drive(duty, ambient)
        if not np.any(duty):
            hears = scene.memory.get("hears", False)
            scene.memory["off"] = scene.time if hears else scene.device.twin.time

    scene.device.twin.drive = noted  # pyright: ignore[reportAttributeAccessIssue]


# ---------------------------------------------------------------------------- what cameras do


def pixels(change: Callable[[Scene, np.ndarray], np.ndarray]):
    """Frames with other pixels."""

    def spoken(scene: Scene, said: Messages) -> Messages:
        return [
            Image(m.seq, m.device_us, m.flags, change(scene, m.pixels).astype(np.uint16))
            if isinstance(m, Image)
            else m
            for m in said
        ]

    return spoken


def first(scene: Scene, image: np.ndarray) -> np.ndarray:
    return scene.memory.setdefault("image", image)


def kelvin(change: Callable[[Scene], float]):
    """Frames that are so many kelvin off."""
    return pixels(lambda s, image: np.clip(image.astype(float) + 100 * change(s), 0, 65535))


def a_zone(value: Callable[[Scene], float]):
    """Frames in which one zone shows something else, degC."""

    def changed(scene: Scene, image: np.ndarray) -> np.ndarray:
        image = image.copy()
        image[12:30, 0:13] = round(100 * (value(scene) + 273.15))
        return image

    return pixels(changed)


def flags(scene: Scene, said: Messages) -> Messages:
    return [Image(m.seq, m.device_us, 1, m.pixels) if isinstance(m, Image) else m for m in said]


def without(*kinds: type):
    """What the device says, without some of it."""
    return lambda scene, said: [m for m in said if not isinstance(m, kinds)]


# ------------------------------------------------------------------------ what sensors do


def channel(value: Callable[[Scene, float], float | str]):
    """Sensors of which the third says something else: a number, or why it has failed."""

    def spoken(scene: Scene, said: Messages) -> Messages:
        changed = []
        for m in said:
            if isinstance(m, Data):
                values = list(m.temperatures)
                new = value(scene, values[2])
                values[2] = float("nan") if isinstance(new, str) else new
                faults = {2: new} if isinstance(new, str) else {}
                m = replace(m, temperatures=tuple(values), faults=faults)
            changed.append(m)
        return changed

    return spoken


def every_channel(value: Callable[[Scene], float]):
    """Sensors all of which say something else from the beginning of the run on."""

    def spoken(scene: Scene, said: Messages) -> Messages:
        return [
            replace(m, temperatures=tuple(value(scene) for _ in m.temperatures))
            if isinstance(m, Data)
            else m
            for m in said
        ]

    return spoken


def covered(share: Callable[[Scene], float]):
    """All sensors show a part of their rise above the room: their contact is bad, or covered."""

    def spoken(scene: Scene, said: Messages) -> Messages:
        part = scene.memory.setdefault("share", share(scene))

        def shown(values: Sequence[float]) -> tuple[float, ...]:
            return tuple(scene.room + part * (value - scene.room) for value in values)

        return [
            replace(m, temperatures=shown(m.temperatures)) if isinstance(m, Data) else m
            for m in said
        ]

    return spoken


# ------------------------------------------------------------------ what controllers do


def samples(change: Callable[[Scene, Data], Data]):
    """Other samples."""
    return lambda scene, said: [change(scene, m) if isinstance(m, Data) else m for m in said]


def stamps(change: Callable[[Scene, int], int]):
    """Everything at another device time."""

    def spoken(scene: Scene, said: Messages) -> Messages:
        for place, m in enumerate(said):
            if isinstance(m, Image):
                said[place] = Image(m.seq, change(scene, m.device_us), m.flags, m.pixels)
            elif hasattr(m, "device_us"):
                said[place] = replace(m, device_us=change(scene, m.device_us))
        return said

    return spoken


def cold_room(scene: Scene, sample: Data) -> Data:
    return replace(sample, ambient=-273.15)


def runs_away(scene: Scene) -> None:
    """The bridge gives full duty whatever was asked, until it is told to switch off."""
    if any(scene.device.pwm):
        scene.device.stage.pwm = (255, 255)


def ignores(scene: Scene, heard: Messages) -> Messages:
    """What was last applied stays; commands to switch off still work."""
    return [
        replace(m, pwm=scene.device.pwm) if isinstance(m, Duty) and any(m.pwm) else m for m in heard
    ]


def waiting(*kinds: type):
    """Messages that wait longer and longer on the way: by a second more every two seconds."""

    def spoken(scene: Scene, said: Messages) -> Messages:
        queue = scene.memory.setdefault("queue", [])
        queue += [(scene.time + scene.since / 2, m) for m in said if isinstance(m, kinds)]
        scene.memory["queue"] = [(due, m) for due, m in queue if due > scene.time]
        others = [m for m in said if not isinstance(m, kinds)]
        return [*others, *(m for due, m in queue if due <= scene.time)]

    return spoken


def rate_of_clock(factor: float):
    """A clock of the device that runs at another rate from the onset on."""

    def changed(scene: Scene, us: int) -> int:
        first = scene.memory.setdefault("clock", us)
        return round(first + factor * (us - first))

    return stamps(changed)


def late(scene: Scene, heard: Messages) -> Messages:
    waiting = scene.memory.setdefault("late", [])
    waiting += [(scene.time, m) for m in heard]
    due = [m for time, m in waiting if scene.time - time >= 3.0]
    scene.memory["late"] = [(time, m) for time, m in waiting if scene.time - time < 3.0]
    return due


def once(act: Callable[[Scene], None]):
    """Something that happens one time."""

    def happens(scene: Scene) -> None:
        if not scene.memory.setdefault("done", False):
            scene.memory["done"] = True
            act(scene)

    return happens


def restarts(scene: Scene) -> None:
    scene.device.hello = replace(scene.device.hello, boot="another")
    scene.device.stage.trip("start")
    scene.device.stage.trip_reason = ""
    scene.device._answer += encode(scene.device.hello)


def hangs_up(scene: Scene) -> None:
    scene.device.due(scene.clock.now())  # it goes on, though nobody hears it
    raise ConnectionResetError("cut")


def is_taken(scene: Scene) -> None:
    now = scene.device.twin.time
    scene.device.stage.owner = ""
    scene.device.stage.obey(Duty(1, scene.device.pwm, "second"), now)


def controller(value: Callable[[Moment, Any], Any]):
    """A schedule or controller of the user's that fails."""

    def happens(scene: Scene) -> None:
        scene.memory["controller"] = value

    return happens


def gives_nan(moment: Moment, asked: Any) -> Any:
    """A controller of a file does so by itself once its state is lost; a schedule is made to."""
    duty = asked(moment)
    return duty if isinstance(asked, LiveLoop) else (float("nan"), duty[1])


def raises(moment: Moment, asked: Any) -> None:
    raise RuntimeError("a bug")


def dies(scene: Scene) -> None:
    """The host's process is killed: nothing is sent any more, not even a stop."""
    assert scene.bench is not None
    scene.bench.send_duty = lambda pwm: True  # pyright: ignore[reportAttributeAccessIssue]
    scene.bench.send_order = lambda kind: True  # pyright: ignore[reportAttributeAccessIssue]


def hotter(scene: Scene) -> bool:
    return float(scene.device.twin.temperatures.max()) > scene.room + 12.0


def hides_much(scene: Scene) -> bool:
    """The plate under a sensor that stands still is much warmer than it reads."""
    value = scene.memory.get("value")
    warmer = 0.0 if value is None else float(scene.device.twin.temperatures[2]) - value
    return warmer > STILL_KELVIN


def above_the_limit(scene: Scene) -> bool:
    """The plate is hotter than the twin of another day allows, which is what nobody sees."""
    return scene.hottest > scene.limit + HIDDEN_KELVIN


def hotter_inside(scene: Scene) -> bool:
    twin = scene.device.twin.system.wiring
    sides = np.array([twin.cold, twin.hot])
    return float(scene.device.twin.nodes[sides].max()) > scene.room + 19.0 + TWIN_KELVIN


def stopped_by_another(scene: Scene) -> None:
    scene.device.receive(encode(Order("stop", 1, "somebody")))


def too_hot_by_itself(scene: Scene) -> None:
    scene.device.stage.trip("over-temperature")


def begins_to_heat(scene: Scene) -> bool:
    return any(scene.device.pwm)


def frozen_value(scene: Scene, value: float) -> float:
    return scene.memory.setdefault("value", value)


# With the next frame, at four a second, and two turns of a slow host, s.
NEXT = 0.6

# Twice the time in which 70 % of full duty warms the plate by 28 K, s.
BENCH = 100.0

# The heat of 15 s at full duty, with the lowest duty of a run, s.
STILL = 15.0 / 0.4 + 1.0

# How far the side of a cell may be above its limit before its twin says so, K: the twin is that of
# other days, and the contact of a cell differs between days.
TWIN_KELVIN = 7.0

# How much the plate under a single sensor may be warmer than it reads, K.
STILL_KELVIN = 28.0

# How far the plate may be above the limit when all sensors hide it, K: the duty tells the twin of
# another day how hot it is.
HIDDEN_KELVIN = 5.0

# The time in which a message that waits half a second longer each second is 3 s late, and when it
# arrives, s.
WAITS = 11.0

SILENCE = 3.6

# A command that changes comes 0.7 s after the onset, and may take a second to show.
CHANGE = 2.4

WATCHDOG = 2.6
LOST = ("disobedience", "unacknowledged", "device-trip")
ODD = ("rate", "deviation")
TOO_HOT = ("over-temperature", "predicted-temperature")
HIDDEN = (*TOO_HOT, "gain", "unresponsive", "deviation", "completed")
HOT, WRONG, DEAF = ("over-temperature",), ("implausible",), ("silence", "link-down")

# All of them.
HAZARDS = (
    # What a camera does.
    Hazard("camera: all pixels 0", WRONG, NEXT, pixels(lambda s, i: i * 0)),
    Hazard("camera: all pixels 65535", HOT, NEXT, pixels(lambda s, i: i * 0 + 65535)),
    Hazard("camera: image stands still", ("frozen", "deviation"), 11.0, pixels(first)),
    Hazard("camera: 30 K up at once", ODD, NEXT, kelvin(lambda s: 30.0)),
    Hazard("camera: 30 K down at once", ODD, NEXT, kelvin(lambda s: -30.0)),
    Hazard("camera: drifts up 8 K/s", ODD, 3.0, kelvin(lambda s: 8 * s.since)),
    Hazard("camera: drifts down 8 K/s", ODD, 3.0, kelvin(lambda s: -8 * s.since)),
    Hazard("camera: noise of 20 K", ODD, 2.0, kelvin(lambda s: 20 * s.random.normal())),
    Hazard("camera: a zone at 0 K", WRONG, NEXT, a_zone(lambda s: -273.15)),
    Hazard("camera: a zone at 300 degC", HOT, NEXT, a_zone(lambda s: 300.0)),
    Hazard("camera: a zone 44 K above the room", ODD, NEXT, a_zone(lambda s: s.room + 44)),
    Hazard("camera: a zone flickers", ODD, 2.0, a_zone(lambda s: s.room + 40 * s.random.random())),
    Hazard("camera: recalibrates for ever", ("silence",), SILENCE, flags),
    Hazard("camera: silent", ("silence",), SILENCE, without(Image)),
    # What a sensor does.
    Hazard("sensor: nan", ("channel-fault",), NEXT, channel(lambda s, v: "nan"), sensors=True),
    Hazard("sensor: open", ("channel-fault",), NEXT, channel(lambda s, v: "open"), sensors=True),
    Hazard("sensor: -273.15 degC", WRONG, NEXT, channel(lambda s, v: -273.15), sensors=True),
    Hazard("sensor: 1372 degC", HOT, NEXT, channel(lambda s, v: 1372.0), sensors=True),
    Hazard("sensor: 40 K off", ODD, NEXT, channel(lambda s, v: v + 40), sensors=True),
    Hazard(
        "sensor: stands still", ("frozen", "deviation"), STILL, channel(frozen_value), sensors=True
    ),
    Hazard(
        "sensor: on the bench",
        ("unresponsive", "deviation"),
        BENCH,
        channel(lambda s, v: s.room + s.random.normal(0, 0.1)),
        sensors=True,
        heats=True,
        begins=begins_to_heat,
    ),
    Hazard(
        "sensors: all on the bench",
        ("unresponsive", "deviation", "rate"),  # the last one if the plate was warm
        BENCH,
        every_channel(lambda s: s.room + s.random.normal(0, 0.1)),
        sensors=True,
        heats=True,
        begins=begins_to_heat,
    ),
    Hazard(
        "sensor: stands still, with noise",
        ("unresponsive", "deviation", "completed"),
        NEXT,
        channel(lambda s, v: frozen_value(s, v) + s.random.normal(0, 0.1)),
        sensors=True,
        begins=hides_much,
        heats=True,
    ),
    *(
        Hazard(
            f"sensors: all show {words} of their rise",
            HIDDEN,
            0.0,
            covered(share),
            sensors=True,
            limits={"temperature": 25},
            begins=above_the_limit,
            heats=True,
            lasts=300.0,
        )
        for words, share in (
            ("a part", lambda s: s.random.uniform(0, 1)),
            ("half", lambda s: 0.5),
            ("three quarters", lambda s: 0.75),
        )
    ),
    # What the rig does.
    Hazard("plate 12 K above the room", TOO_HOT, NEXT, limits={"temperature": 12}, begins=hotter),
    Hazard(
        "cell 19 K above the room inside",
        ("cell-temperature",),
        1.0,
        limits={"cell_temperature": 19},
        begins=hotter_inside,
    ),
    Hazard("bridge: full duty", ("disobedience",), NEXT, happens=runs_away),
    Hazard("bridge: stuck at the last duty", ("disobedience",), CHANGE, heard=ignores),
    # What a controller and its link do.
    Hazard("controller: silent", ("silence",), SILENCE, without(Data)),
    Hazard("device: silent", DEAF, SILENCE, lambda s, m: []),
    Hazard("device: garbage", DEAF, SILENCE, lambda s, m: [s.random.bytes(300)]),
    Hazard("device: hangs up", ("link-down",), WATCHDOG, happens=hangs_up),
    Hazard("device: restarts", ("restart", "disobedience"), NEXT, happens=once(restarts)),
    Hazard(
        "device: clock an hour ahead",
        ("restart", "silence"),
        SILENCE,
        stamps(lambda s, t: t + 3_600_000_000),
    ),
    Hazard("device: clock back at 0", ("restart", *DEAF), SILENCE, stamps(lambda s, t: 0)),
    Hazard("device: clock 50 s ahead", ("clock",), NEXT, stamps(lambda s, t: t + 50_000_000)),
    Hazard("device: clock at a fifth", ("late",), 5.0, rate_of_clock(0.2)),
    Hazard("device: clock twice as fast", ("clock", "restart"), 5.0, rate_of_clock(2.0)),
    Hazard("camera: frames wait ever longer", ("late",), WAITS, waiting(Image)),
    Hazard("device: all waits ever longer", ("late", *LOST), WAITS, waiting(Image, Data)),
    Hazard("device: old numbers", DEAF, SILENCE, samples(lambda s, d: replace(d, seq=1))),
    Hazard(
        "device: reports no duty",
        ("disobedience",),
        NEXT,
        samples(lambda s, d: replace(d, pwm=(0, 0))),
    ),
    Hazard("device: room at -273.15 degC", WRONG, NEXT, samples(cold_room)),
    Hazard("device: somebody stops it", ("device-trip",), NEXT, happens=once(stopped_by_another)),
    Hazard("device: trips on heat", ("device-trip",), NEXT, happens=once(too_hot_by_itself)),
    Hazard("commands: lost", LOST, WATCHDOG, heard=lambda s, m: []),
    Hazard("commands: three seconds late", LOST, WATCHDOG, heard=late),
    Hazard(
        "commands: duty damaged",
        LOST,
        CHANGE,
        heard=lambda s, h: [m for m in h if isinstance(m, Order)],
    ),
    Hazard("commands: another host's", ("commander", *LOST), 1.0, happens=once(is_taken)),
    # What the host does.
    Hazard("controller: NaN", ("error", "controller"), NEXT, happens=controller(gives_nan)),
    Hazard("controller: raises", ("exception",), NEXT, happens=controller(raises)),
    Hazard("host: killed", LOST, WATCHDOG, happens=once(dies)),
)


# ------------------------------------------------------------------ what follows the end


@final
@dataclass(frozen=True)
class AfterStop:
    """What a rig does after its device reports that the cells are off.

    - `heats`: the duty that heats it although the device reports none, by the time since the end
      and the last duty.
    - `verdicts`: what the readings may show.
    - `reports`: whether the device reports the heat.
    """

    name: str
    heats: Callable[[float, np.ndarray], np.ndarray] | None
    verdicts: tuple[str, ...]
    reports: bool = False


class Seen(NamedTuple):
    """What the readings showed after the end of a run: after what time, s, and as it was said; and
    the temperature that the plate really reached, degC, with its limit."""

    verdict: str
    after: float
    said: str
    hottest: float
    limit: float


def run_after_stop(
    case: AfterStop,
    twins: Sequence[Twin],
    seed: int,
    truth: Mapping[str, float] = MappingProxyType({}),
    draws: Mapping[str, np.ndarray] | None = None,
) -> Seen:
    """Drives a virtual rig for one to three minutes, and lets it do something after the end. Odd
    seeds have sensors in place of the camera; every third run is ended by an interlock."""
    random = np.random.default_rng(seed)
    room, twin = random.uniform(5, 40), twins[seed % 2]
    clock = HandClock()
    device = VirtualRig(Twin(twin.rig, {**twin.values, **truth, "T_amb": room}), seed=seed)
    device.twin.start(0.0, room)
    plant, ended, hottest = device.twin, [], [room]
    drive_plant, advance, last = plant.drive, plant.advance, [np.zeros(2)]

    def driven_plant(duty: np.ndarray, ambient: float | None = None) -> None:
        if np.any(duty):
            last[0] = np.asarray(duty)
        elif not ended and np.any(last[0]):
            ended.append(plant.time)
        drive_plant(duty, ambient)

    def advanced(time: float) -> np.ndarray:
        if ended and case.heats is not None:
            duty = case.heats(time - ended[0], last[0])
            drive_plant(duty)
            if case.reports:
                device.stage.pwm = tuple(round(255 * part) for part in duty)
        readings = advance(time)
        hottest.append(float(plant.nodes[: plant.system.wiring.elements].max()))
        return readings

    plant.drive, plant.advance = driven_plant, advanced  # pyright: ignore
    duration = float(random.uniform(60, 180))
    duty = random.uniform(0.35, 0.8, 2)
    plan = Experiment.schedule(f"0:{duty[0]:.2f}/{duty[1]:.2f}", duration=duration, cells=2)
    bench = stepped_bench(twin.rig, {"rig": lambda: InProcess(device, clock)}, clock, step=0.1)
    ends: list[Ending] = []
    alarms: list[int] = []
    said = ""

    def trip(time: float, pwm: tuple[int, ...]) -> None:
        if seed % 3 == 0 and time > duration / 2:
            raise SafetyStop("stopped: an interlock", "interlock")

    begin = clock.now()
    try:
        guard = Guard.of(twin, ambient=room, draws=draws)
        drive(
            bench,
            guard,
            plan,
            accept=True,
            on_progress=trip,
            on_end=ends.append,
            on_alarm=lambda finding: alarms.append(clock.now()),
        )
    except SafetyStop as stop:
        said = str(stop)
    ending = ends[-1]
    shown = alarms[0] if alarms else clock.now()
    after = (shown - begin) * 1e-9 - (ended[0] if ended else 0.0)
    assert twin.rig.limits is not None
    limit = twin.rig.limits.temperature - 273.15
    return Seen(ending.verdict, after, said or str(ending), max(hottest), limit)


# All of them.
AFTER_STOP = (
    AfterStop("after the end: nothing", None, ("off", "unknown")),
    AfterStop("after the end: the last duty goes on, reported as off", lambda t, u: u, ("heats",)),
    AfterStop(
        "after the end: full duty, reported as off", lambda t, u: np.ones_like(u), ("heats",)
    ),
    AfterStop(
        "after the end: it heats again 1 s later, reported as off",
        lambda t, u: u * (t > 1.0),
        ("heats",),
    ),
    AfterStop(
        "after the end: it heats again 1 s later, and reports it",
        lambda t, u: u * (t > 1.0),
        ("heats",),
        reports=True,
    ),
    AfterStop(
        "after the end: another controller heats from 3 s on",
        lambda t, u: 0.8 * np.ones_like(u) * (t > 3.0),
        ("heats",),
    ),
)

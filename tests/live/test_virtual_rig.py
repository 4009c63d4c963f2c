"""The virtual rig and the live twin against `simulate`, and its faults."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from folded import feed
from hand_clock import START, HandClock, virtual_bench

import jaxtwin as jt
from jaxtwin import JaxtwinError
from jaxtwin.errors import LinkError
from jaxtwin.io import Experiment, Session, read_recording
from jaxtwin.live import (
    Duty,
    Event,
    Follower,
    Gap,
    Image,
    LinkChange,
    LinkState,
    Plant,
    Reading,
    Recorder,
    Replay,
    RigState,
    Sample,
    VirtualRig,
    deframe,
    encode,
    parse,
    report,
)
from jaxtwin.live.virtual_rig._virtual_rig import VirtualPicture
from jaxtwin.physics import Faults, Twin, frame_to_channels
from jaxtwin.rig import Rig


def in_step(twin: Twin, experiment: Experiment) -> np.ndarray:
    """Channels of a twin that is stepped through an experiment, `(times, channels)`."""
    assert isinstance(experiment.ambient, float)
    live = Plant(twin)
    channels = []
    for time, duty in zip(experiment.time, experiment.duty, strict=True):
        channels.append(live.advance(float(time)))
        live.drive(duty, ambient=experiment.ambient)
    return np.array(channels)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dual-cell", "paper-2024"])  # with a driver that lags, without
def test_the_twin_in_step_is_the_twin_simulated(name: str) -> None:
    twin = Twin(jt.load_rig(name))
    experiment = Experiment.schedule("0:0.5,50:0.78/-0.4", duration=100, cells=2, ambient=12.0)
    truth = twin.simulate(experiment)
    # At time 0 the twin in step has not been told yet that the room is colder.
    np.testing.assert_allclose(in_step(twin, experiment)[1:], truth.temperatures[1:], atol=2e-4)


@pytest.mark.usefixtures("float64")
def test_a_warmer_room_is_in_the_readings_at_once(twin: Twin) -> None:
    live = Plant(twin)
    cold = live.temperatures
    live.drive(np.zeros(2), ambient=live.ambient + 10)
    # The camera sees ambient + gain (T - ambient) on the plate.
    system = live.system
    seen = 10 * (1 - np.asarray(system.gain) * np.asarray(system.on_plate))
    np.testing.assert_allclose(live.temperatures - cold, seen, atol=1e-9)
    assert np.abs(seen).max() > 0.01


def test_a_frame_shows_each_channel_what_the_twin_says_it_reads(rig: Rig, twin: Twin) -> None:
    live = Plant(twin)
    live.drive(np.array([0.78, 0.3]))
    live.advance(400.0)
    assert rig.camera is not None
    picture = VirtualPicture(twin, rig.camera, live.system)
    frame = picture.frame(live.nodes, live.ambient)
    assert frame.shape == (60, 80)
    # Pixels are rounded to 0.01 K.
    read = frame_to_channels(rig, frame / 100 - 273.15)
    np.testing.assert_allclose(read, live.temperatures, atol=0.005)


def heard(device: VirtualRig, clock: HandClock, seconds: float) -> bytes:
    sent = device.connected()
    for _ in range(round(seconds / 0.1)):
        sent += device.due(clock.now())
        clock.turn(0.1)
    return sent


def test_the_same_seed_sends_the_same_bytes(twin: Twin) -> None:
    faults = Faults.parse("drop=0.1,corrupt=0.1,jumps=3")
    sent = [
        heard(VirtualRig(twin, seed=s, faults=faults, boot="b"), HandClock(), 10.0)
        for s in (1, 1, 2)
    ]
    assert sent[0] == sent[1]
    assert sent[0] != sent[2]


@pytest.mark.parametrize(
    ("is_stated", "size", "relaxation"), [(True, 1.0, (10, 40)), (False, 0.8, (25,))]
)
def test_a_recalibration_jumps_and_fades_as_the_rig_file_says(
    rig: Rig, is_stated: bool, size: float, relaxation: tuple[int, ...]
) -> None:
    """The mean of all pixels of a plate at rest, by the sum of decays that a match assumes."""
    assert rig.camera is not None
    if not is_stated:
        rig = replace(rig, camera=replace(rig.camera, common_error=None))
    device = VirtualRig(Twin(rig), seed=5, camera_rate=1, faults=Faults.parse("jumps=20"))
    frames, _, _ = deframe(b"", heard(device, HandClock(), 40.0))
    images = [message for message in map(parse, frames) if isinstance(message, Image)]
    mean = np.array([image.pixels.mean() / 100 for image in images])
    assert len(images) == 40
    assert [image.device_us for image in images if image.flags] == [20_000_000]
    assert mean[20] == mean[19]  # the shutter is closed: the image stands
    random = np.random.default_rng([5, 1])
    jumps = [random.normal(0, size) for _ in relaxation]
    elapsed = np.arange(1, 20)
    offset = sum(b * np.exp(-elapsed / tau) for b, tau in zip(jumps, relaxation, strict=True))
    # The mean of 4800 pixels has a noise of 1.4 mK.
    np.testing.assert_allclose(mean[21:40] - mean[:20].mean(), offset, rtol=0, atol=0.01)


def test_each_start_has_another_name_whatever_the_seed(twin: Twin) -> None:
    assert VirtualRig(twin, seed=1).hello.boot != VirtualRig(twin, seed=1).hello.boot


def test_rates_are_those_that_were_asked_for(twin: Twin) -> None:
    device = VirtualRig(twin, speed=10, camera_rate=4, controller_rate=5)
    kinds = Counter(
        type(parse(frame)).__name__
        for frame in deframe(b"", heard(device, HandClock(), 10.0)).frames
    )
    # Up to 99 s of the rig, from 0 s on.
    assert kinds == {"Hello": 1, "Image": 397, "Data": 496}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"watchdog": 20}, r"watchdog: expected 0\.1 to 5 s of a device that drives, got 20 s"),
        ({"watchdog": 0}, "watchdog: expected"),
        ({"watchdog": float("nan")}, "watchdog: expected"),
        ({"speed": 2000}, "rate: expected"),
    ],
)
def test_a_device_that_every_host_refuses_is_refused_at_once(
    twin: Twin, wrong: dict[str, Any], message: str
) -> None:
    with pytest.raises(LinkError, match=f"virtual rig: {message}"):
        VirtualRig(twin, **wrong)


def test_without_commands_its_own_watchdog_switches_the_cells_off(twin: Twin) -> None:
    device, clock = VirtualRig(twin, watchdog=1.5), HandClock()
    heard(device, clock, 1.0)
    device.receive(encode(Duty(1, (100, -100), "me")))
    heard(device, clock, 1.4)
    assert device.pwm == (100, -100)
    sent = heard(device, clock, 0.5)
    assert device.pwm == (0, 0)
    assert "watchdog" in {getattr(parse(f), "why", "") for f in deframe(b"", sent).frames}


@pytest.mark.slow
def test_it_trips_by_itself_above_the_limit(rig: Rig) -> None:
    assert rig.limits is not None
    cautious = replace(rig, limits=replace(rig.limits, temperature=273.15 + 10))
    device, clock = VirtualRig(Twin(cautious), speed=10), HandClock()
    sent, hottest = b"", -np.inf
    for number in range(60):
        device.receive(encode(Duty(number, (255, 255), "me")))
        sent += heard(device, clock, 0.5)
        hottest = max(hottest, device.twin.temperatures.max())
    assert device.stage.trip_reason == "over-temperature"
    whys = [getattr(parse(f), "why", "") for f in deframe(b"", sent).frames]
    assert whys.count("over-temperature") == 1
    # Ten kelvin above the limit.
    assert 19 < hottest < 30


def test_a_command_beyond_full_duty_is_refused(twin: Twin) -> None:
    device = VirtualRig(twin)
    device.receive(encode(Duty(1, (100, 0), "me")))
    device.receive(encode(Duty(2, (300, 0), "me")))
    device.receive(encode(Duty(3, (1, 2, 3), "me")))  # of another rig
    assert device.pwm == (100, 0)


@pytest.mark.slow
def test_faults_happen_when_they_should(twin: Twin) -> None:
    device, clock = VirtualRig(twin, faults=Faults.parse("loosen=P1@5/100,fail=P2@8")), HandClock()
    before = device.twin.system
    heard(device, clock, 5.0)
    assert device.twin.system is before
    heard(device, clock, 1.0)
    loose = device.twin.system
    assert loose is not before
    heard(device, clock, 3.0)
    resistance = np.asarray(device.twin.system.module.electrical_resistance)
    assert resistance[1] == 1e9
    assert resistance[0] < 10


@pytest.mark.parametrize(
    "text",
    [
        "drop=2",
        "drop",
        "burn=1",
        "loosen=P1",
        "stall=1",
        "fail=P2@x",
        "jumps=nan",
        "jumps=-1",
        "age=P1@3/0",
    ],
)
def test_an_unknown_or_malformed_fault_is_refused_and_quoted(text: str) -> None:
    with pytest.raises(JaxtwinError, match="expected words like drop="):
        Faults.parse(text)


def test_a_fault_of_a_cell_that_is_not_there_is_refused(twin: Twin) -> None:
    with pytest.raises(JaxtwinError, match=r"unknown cell 'P3'.* Known: P1, P2"):
        VirtualRig(twin, faults=Faults.parse("fail=P3@1"))


def test_recorded_losses_are_those_that_happened(
    rig: Rig, twin: Twin, clock: HandClock, tmp_path: Path
) -> None:
    faults = Faults.parse("drop=0.05,corrupt=0.05,disconnect=7,stall=9/0.5,jumps=5")
    device = VirtualRig(twin, seed=3, faults=faults)
    file = tmp_path / "session.db"
    with Recorder(file, rig, clock=clock, keep_frames=True) as recorder:
        bench = virtual_bench(rig, device, clock, journal=recorder)
        records = [record for _ in range(600) for record in bench.poll()]
    samples = [r.seq for r in records if isinstance(r, Sample)]
    readings = [r for r in records if isinstance(r, Reading)]
    gaps = [r for r in records if isinstance(r, Gap)]
    lost = {
        n for gap in gaps if gap.stream == "data" for n in range(gap.first, gap.first + gap.count)
    }
    assert len(samples) == len(set(samples)) > 200
    assert set(samples) | lost == set(range(samples[0], samples[-1] + 1))
    assert not set(samples) & lost
    assert len({r.seq for r in readings}) == len(readings) > 150
    assert sum(isinstance(r, LinkChange) and r.state is LinkState.DOWN for r in records) >= 3
    assert any(isinstance(r, Event) and r.kind == "recalibration-start" for r in records)
    with Session(file) as session:
        content = report(session)
    assert content["lost"]["data"] == len(lost)
    assert sum(stream["count"] for stream in content["streams"]) == len(samples) + len(readings)
    # Ten messages a second of the rig; the link is down, stalls or jumps for seconds.
    for stream in content["streams"]:
        assert 0.05 < stream["period"] < 0.25
        assert stream["period"] <= stream["longest"] < 60


@pytest.fixture(scope="module")
def recorded(rig: Rig, twin: Twin, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list]:
    """Two minutes of a virtual rig, 20 times as fast: the file, and the records as they came."""
    clock = HandClock()
    file = tmp_path_factory.mktemp("recorded") / "run.db"
    device = VirtualRig(twin, speed=20, seed=1)
    with Recorder(file, rig, clock=clock, keep_frames=True) as recorder:
        bench = virtual_bench(rig, device, clock, journal=recorder)
        records: list = []
        for step in range(125):
            if step % 5 == 0:
                bench.send_duty((128, 200) if step < 60 else (200, 0))
            records += bench.poll()
    return file, records


@pytest.mark.slow
def test_a_recording_read_back_is_what_the_twin_did(
    twin: Twin, recorded: tuple[Path, list]
) -> None:
    experiment = read_recording(recorded[0])
    assert experiment.channels == twin.channels
    assert experiment.ambient == 16.0
    assert set(experiment.time) == set(range(int(experiment.time[-1]) + 1))
    assert experiment.duration > 110
    # The device's first second, before the first command, decides the node temperatures: equal.
    error = np.asarray(experiment.temperatures) - in_step(twin, experiment)
    # Half a step of a duty switch at 0.5 K/s, and noise of 0.1 K over pixels and frames.
    assert np.abs(error).max() < 0.3
    assert np.sqrt(np.mean(error**2)) < 0.1


@pytest.mark.slow
def test_a_part_and_another_step_can_be_taken(recorded: tuple[Path, list]) -> None:
    with Session(recorded[0]) as session:
        part = session.experiment(step=0.5, start=20.0, end=40.0)
        assert session.rig.name == "dual-cell"
    assert part.time[0] == pytest.approx(20.0)
    assert part.time[-1] == pytest.approx(40.0)
    assert np.diff(part.time) == pytest.approx(0.5)


@pytest.mark.slow
def test_a_gap_in_the_data_is_a_gap_between_two_parts_of_the_experiment(
    rig: Rig, twin: Twin, clock: HandClock, tmp_path: Path
) -> None:
    file = tmp_path / "gap.db"
    device = VirtualRig(twin, speed=10, faults=Faults.parse("stall=60/20"))
    with Recorder(file, rig, clock=clock) as recorder:
        bench = virtual_bench(rig, device, clock, journal=recorder)
        for _ in range(250):
            bench.poll()
    with Session(file) as session:
        experiment = session.experiment()
    ((start, end),) = experiment.gaps
    assert (start, end) == (pytest.approx(60, abs=1.5), pytest.approx(80, abs=1.5))
    first, second = read_recording(file).parts
    assert (first.time[-1], second.time[second.sampled.any(axis=1)][0]) == (start, end)


@pytest.mark.slow
def test_a_replay_is_the_records_once_more(recorded: tuple[Path, list]) -> None:
    file, records = recorded
    with Replay(file, speed=float("inf")) as replay:
        again = list(replay)
    kinds, kinds_again = (Counter(type(r).__name__ for r in part) for part in (records, again))
    kinds["Event"] += 1  # the end of the recording, which nobody had seen then
    assert kinds_again == kinds
    for kind in (Sample, Reading):
        originals = [record for record in records if isinstance(record, kind)]
        replayed = [record for record in again if isinstance(record, kind)]
        for a, b in zip(originals, replayed, strict=True):
            if isinstance(a, Reading) and isinstance(b, Reading):
                np.testing.assert_array_equal(a.temperatures, b.temperatures)
                np.testing.assert_array_equal(a.pixels, b.pixels)
                a = replace(a, temperatures=np.zeros(15), pixels=None)
                b = replace(b, temperatures=np.zeros(15), pixels=None)
                assert repr(a) == repr(b)
            else:
                assert a == b


@pytest.mark.slow
def test_a_replay_at_double_speed_takes_half_the_time(
    recorded: tuple[Path, list], clock: HandClock
) -> None:
    file, records = recorded
    with Replay(file, speed=2.0, clock=clock) as replay:
        list(replay)
    recorded_seconds = (records[-1].arrival - records[0].arrival) * 1e-9
    assert (clock.now() - START) * 1e-9 == pytest.approx(recorded_seconds / 2, rel=0.05)


@pytest.mark.slow
def test_the_follower_predicts_what_is_measured_in_step(
    twin: Twin, recorded: tuple[Path, list]
) -> None:
    follower = Follower(twin)
    feed(follower, recorded[1], START, RigState())
    assert follower.predicted is not None
    assert follower.measured is not None
    # 50 ms between two polls of the fixture are one second of the rig.
    assert np.abs(follower.predicted - follower.measured).max() < 1.0
    assert follower.measured.max() > 25.0

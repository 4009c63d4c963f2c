"""A device's side of the commands: one commander, nothing cut to fit, trips that stay."""

import pytest

from jaxtwin.live import Duty, Order, OutputStage


@pytest.fixture
def stage() -> OutputStage:
    made = OutputStage(2, 255, 2.0)
    made.obey(Duty(1, (100, -100), "first"), 0.0)
    return made


def test_the_first_host_owns_the_cells_and_a_duty_of_another_is_refused(stage: OutputStage) -> None:
    assert stage.obey(Duty(9, (255, 255), "second"), 0.5) == ("refused", "owner")
    assert (stage.pwm, stage.owner, stage.number) == ((100, -100), "first", 1)


def test_silence_with_cells_on_trips_and_the_trip_stays_until_a_reset(stage: OutputStage) -> None:
    assert stage.on_time(2.0) is None
    assert stage.on_time(2.1) == ("trip", "watchdog")
    assert stage.pwm == (0, 0)
    assert stage.obey(Duty(2, (50, 50), "first"), 3.0) == ("refused", "tripped")
    assert stage.obey(Order("reset", 3, "second"), 3.0) == ("reset", "")
    assert stage.pwm == (0, 0)
    assert stage.obey(Duty(4, (50, 50), "second"), 3.1) is None
    assert stage.pwm == (50, 50)


def test_silence_with_cells_off_ends_the_command_without_a_trip(stage: OutputStage) -> None:
    stage.obey(Duty(2, (0, 0), "first"), 1.0)
    assert stage.on_time(3.1) is None
    assert (stage.owner, stage.trip_reason) == ("", "")
    assert stage.obey(Duty(1, (1, 1), "second"), 3.2) is None


def test_anyone_may_stop_and_the_first_reason_is_kept(stage: OutputStage) -> None:
    assert stage.obey(Order("stop", 1, "passer-by"), 0.1) == ("trip", "stop")
    assert (stage.pwm, stage.trip_reason) == ((0, 0), "stop")
    assert stage.trip("over-temperature") is None
    assert stage.obey(Order("stop", 2, "passer-by"), 0.2) is None
    assert stage.trip_reason == "stop"


@pytest.mark.parametrize("number", [1, 0, 2**31 + 1])
def test_a_duty_that_is_not_newer_is_refused_and_feeds_no_watchdog(
    stage: OutputStage, number: int
) -> None:
    """As from a link that repeats a line for ever."""
    for tenth in range(1, 20):
        assert stage.obey(Duty(number, (200, 200), "first"), tenth / 10) == ("refused", "old")
    assert stage.pwm == (100, -100)
    assert stage.on_time(2.1) == ("trip", "watchdog")


def test_command_numbers_wrap_around_after_2_to_the_32(stage: OutputStage) -> None:
    for number in (2**31, 2**32 - 1, 0):
        assert stage.obey(Duty(number, (5, 5), "first"), 0.1) is None
    assert stage.obey(Duty(2**32 - 1, (9, 9), "first"), 0.1) == ("refused", "old")


def test_a_delayed_duty_does_not_heat_after_the_release(stage: OutputStage) -> None:
    stage.obey(Order("release", 2, "first"), 0.1)
    assert stage.obey(Duty(1, (100, -100), "first"), 0.2) == ("refused", "old")
    assert (stage.pwm, stage.owner) == ((0, 0), "")
    assert stage.obey(Duty(3, (1, 1), "first"), 0.3) is None


def test_who_releases_lets_another_command(stage: OutputStage) -> None:
    assert stage.obey(Order("release", 2, "second"), 0.1) == ("refused", "owner")
    assert stage.obey(Order("release", 2, "first"), 0.1) is None
    assert stage.pwm == (0, 0)
    assert stage.obey(Duty(1, (1, 1), "second"), 0.2) is None


def test_a_reset_without_a_trip_does_not_take_the_cells_from_their_commander(
    stage: OutputStage,
) -> None:
    assert stage.obey(Order("reset", 2, "second"), 0.1) == ("refused", "owner")
    assert stage.pwm == (100, -100)


@pytest.mark.parametrize("pwm", [(99999, 0), (0, -256), (1,), (1, 1, 1), ()])
def test_a_duty_out_of_range_is_refused_and_not_clipped(
    stage: OutputStage, pwm: tuple[int, ...]
) -> None:
    assert stage.obey(Duty(2, pwm, "first"), 0.1) == ("refused", "range")
    assert stage.pwm == (100, -100)

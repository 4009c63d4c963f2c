"""A terminal view of a rig: its zones as a coloured map, with duty, rates, losses and the twin
beside it."""

from collections import deque
from collections.abc import Iterator, Sequence
from typing import final

import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.style import Style
from rich.table import Table
from rich.text import Text

from .._celsius import ZERO_CELSIUS
from .._statistics import QUANTILE_975
from ..observers import ExtendedKalmanFilter, Moment, Moments, forecast_from, state_moments
from ..physics import Twin
from ..rig import Channel, Plate
from ._follower import Follower
from .protocol._records import Event, LinkState, Reading, Record, Sample
from .protocol._rig_state import RigState

WIDTH, HEIGHT = 40, 14  # of the map, characters: with the table it fits into 80 x 24
_COLOURS = ((20, 11, 53), (101, 21, 110), (187, 55, 84), (249, 142, 9), (252, 255, 164))
_LINK = {LinkState.LIVE: "green", LinkState.STALE: "yellow", LinkState.CONNECTING: "cyan"}
_COUNTED = ("garbage", "nonsense", "duplicate")  # events that the state counts
_RATE_SECONDS = 5.0

# The time ahead of the forecast of an observer, s.
FORECAST_SECONDS = 60.0

# The largest number of estimated temperatures and heats that are shown.
MAX_NODES = 8

# The age from which on temperatures are shown in red, s: `drive` stops there.
OLD_SECONDS = 3.0


@final
class Screen:
    """The contents of the screen. It consumes the records of a source: of a link, a recording or a
    test.

    **Arguments:**

    - `twin`: the twin that predicts the readings.
    - `observer`: an observer of the rig, whose estimates and forecasts are shown; None: the twin in
      open loop.
    - `follower`: a follower of this observer that an earlier consumer, such as a monitor, has
      already advanced by each record; None: one of its own.
    """

    def __init__(
        self,
        twin: Twin,
        observer: ExtendedKalmanFilter | None = None,
        follower: Follower | None = None,
    ):
        self._rig = twin.rig
        self._follower = Follower(twin, observer) if follower is None else follower
        self._follows = follower is None
        self._observer = observer
        self._nodes = tuple(node.name for node in twin.netlist.nodes)
        if observer is not None:
            self._outlook(observer)  # compiles before the first data arrive
        self._map = _channel_map(twin.rig.plate, twin.rig.channels)
        self._state = RigState()
        self._arrivals: dict[str, deque[int]] = {"frames": deque(), "samples": deque()}
        self._last = ""
        self._now = 0

    @property
    def follower(self) -> Follower:
        """The twin beside the rig."""
        return self._follower

    def on_record(self, record: Record, state: RigState) -> None:
        """Takes the next record, and what is known of the rig after it."""
        if self._follows:
            self._follower.on_record(record, state)
        self._state, self._now = state, max(self._now, record.arrival)
        match record:
            case Sample():
                self._arrivals["samples"].append(record.arrival)
            case Reading():
                self._arrivals["frames"].append(record.arrival)
            case Event() if record.kind not in _COUNTED:
                self._last = _plain(f"{record.kind} {record.detail}".strip())

    def on_time(self, state: RigState, now: int) -> None:
        """Does nothing: the picture shows the time of the records, also of a replay."""

    def render(self) -> RenderableType:
        """Renders the whole view."""
        if not self._rig.has_plate:
            return Group(Panel(self._table(), title=self._rig.name, expand=False), self._status())
        top = Table.grid(padding=(0, 2))
        top.add_row(Panel(self._plate(), title=self._rig.name), self._table())
        return Group(top, self._status())

    def _plate(self) -> Text:
        values = self._follower.measured
        if values is None:
            return Text("\n" * (HEIGHT // 2) + "waiting for temperatures".center(WIDTH))
        if np.isnan(values).all():
            return Text("\n" * (HEIGHT // 2) + "all channels have failed".center(WIDTH))
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        labels = _labels(self._map, [f"{value:.1f}" for value in values])
        text = Text()
        for row in range(HEIGHT):
            for column in range(WIDTH):
                channel = self._map[row, column]
                if channel < 0:
                    text.append(" ")
                    continue
                if np.isnan(values[channel]):  # it has failed
                    text.append(labels.get((row, column), "?"), "bold red")
                    continue
                part = (float(values[channel]) - low) / max(high - low, 0.5)
                ink = "black" if part > 0.6 else "white"
                style = Style(color=ink, bgcolor="rgb({},{},{})".format(*_colour(part)))
                text.append(labels.get((row, column), " "), style)
            if row < HEIGHT - 1:
                text.append("\n")
        return text

    def _table(self) -> RenderableType:
        if self._observer is not None:
            return Group(*self._estimates(self._observer))
        table = Table("degC", box=box.SIMPLE_HEAD)
        for name in ("rig", "twin", "rig - twin"):
            table.add_column(name, justify="right")
        measured, predicted = self._follower.measured, self._follower.predicted
        if measured is None or predicted is None:
            return table
        for channel, real, twin in zip(self._rig.channels, measured, predicted, strict=True):
            table.add_row(channel.name, f"{real:.1f}", f"{twin:.1f}", f"{real - twin:+.1f}")
        return table

    def _estimates(self, observer: ExtendedKalmanFilter) -> Iterator[RenderableType]:
        """Channels with what was and is expected of them, and the state of the rig."""
        measured, predicted = self._follower.measured, self._follower.predicted
        table = Table("degC", box=box.SIMPLE_HEAD)
        for name in ("rig", "expected", f"in {FORECAST_SECONDS:g} s", "±"):
            table.add_column(name, justify="right")
        if measured is None or predicted is None:
            yield table
            return
        later, result = self._outlook(observer)
        for number, channel in enumerate(self._rig.channels):
            cells = measured[number], predicted[number], later.mean[number]
            texts = (f"{value:.1f}" for value in cells)
            table.add_row(channel.name, *texts, f"{QUANTILE_975 * later.spread[number]:.1f}")
        yield table
        estimates = Table("estimate", box=box.SIMPLE_HEAD)
        estimates.add_column("value", justify="right")
        estimates.add_column("±", justify="right")
        unseen = [name for name in self._nodes if "." in name] or list(self._nodes)
        for name in unseen[:MAX_NODES]:
            place = self._nodes.index(name)
            estimates.add_row(f"{name}, degC", *_value(result.nodes, place, 1))
        estimates.add_row("room, degC", *_value(result.room, 0, 1))
        for place, cell in enumerate(self._rig.driven[:MAX_NODES]):
            estimates.add_row(f"unexplained heat {cell}, W", *_value(result.heats, place, 2))
        yield estimates

    def _outlook(self, observer: ExtendedKalmanFilter) -> tuple[Moment, Moments]:
        """What is expected of the readings in a while, and what the state says now."""
        state = self._follower.state
        later = forecast_from(observer, state, self._follower.duty, FORECAST_SECONDS)
        return later, state_moments(observer, state)

    def _status(self) -> Text:
        text = Text()
        for link, state in self._state.links.items():
            text.append(f"{link} {state}  ", _LINK.get(state, "red"))
        sample = self._state.sample
        parts = self._rig.driver.duty(() if sample is None else sample.pwm)
        duty = ", ".join(f"{100 * part:.0f} %" for part in parts) or "-"
        text.append(f"\nduty {duty}")
        if sample is not None:
            room = "" if sample.ambient is None else f", ambient {sample.ambient:.1f} degC"
            text.append(f"{room}, commanded by {_plain(sample.owner) or 'nobody'}")
        if self._state.trip:
            text.append(f"\nTRIPPED: {_plain(self._state.trip)}", "bold red")
        text.append(f"\n{self._limits()}")
        text.append(*self._age())
        text.append("\n")
        for what, arrivals in self._arrivals.items():
            while arrivals and self._now - arrivals[0] > _RATE_SECONDS * 1e9:
                arrivals.popleft()
            text.append(f"{len(arrivals) / _RATE_SECONDS:.1f} {what}/s  ")
        text.append(", ".join(f"{n} {what}" for what, n in self._state.counts.items() if n))
        if self._last:
            text.append(f"\n{self._last}")
        return text

    def _limits(self) -> str:
        """The limits at which the cells are switched off."""
        limits = self._rig.limits
        if limits is None:
            return "no limit in the rig file"
        text = f"off above {limits.temperature - ZERO_CELSIUS:g} degC"
        if limits.cell_temperature is not None:
            text += f", inside a cell above {limits.cell_temperature - ZERO_CELSIUS:g}"
        return text

    def _age(self) -> tuple[str, str]:
        """The age of the last temperatures, and its colour."""
        newest = self._state.measured
        if not newest.any():
            return "", ""
        age = (self._now - int(newest.max())) * 1e-9
        return f", temperatures {age:.1f} s old", "bold red" if age > OLD_SECONDS else ""


def _value(moment: Moment, place: int, digits: int) -> tuple[str, str]:
    """An estimate and half of its 95 % band."""
    spread = QUANTILE_975 * float(moment.spread[place])
    return f"{float(moment.mean[place]):.{digits}f}", f"{spread:.{digits}f}"


def _plain(text: str) -> str:
    """Text of a device, or of a hostile file: a terminal must not obey it."""
    return "".join(c if c.isprintable() else "�" for c in text)


def _channel_map(plate: Plate, channels: Sequence[Channel]) -> np.ndarray:
    """Number of the channel at each character `(HEIGHT, WIDTH)`, the smallest there, or -1."""
    x = (np.arange(WIDTH) + 0.5) * plate.width / WIDTH
    y = (np.arange(HEIGHT) + 0.5) * plate.height / HEIGHT
    result = np.full((HEIGHT, WIDTH), -1)
    boxes = [
        (*extent, number)
        for number, channel in enumerate(channels)
        for extent in channel.sensor.outline(plate)
    ]
    for x0, x1, y0, y1, number in sorted(
        boxes, key=lambda box: (box[1] - box[0]) * (box[3] - box[2]), reverse=True
    ):
        result[np.ix_((y >= y0) & (y < y1), (x >= x0) & (x < x1))] = number
    return result


def _labels(where: np.ndarray, texts: Sequence[str]) -> dict[tuple[int, int], str]:
    """The characters of the labels, each in the middle of its channel if there is room."""
    labels: dict[tuple[int, int], str] = {}
    for number, text in enumerate(texts):
        rows, columns = np.nonzero(where == number)
        if not len(rows):
            continue
        # The name is in the middle row of the channel, or in the nearest row with enough room.
        middle = (rows.min() + rows.max()) / 2
        for row in sorted(set(rows.tolist()), key=lambda row: abs(row - middle)):
            first = int(np.median(columns[rows == row])) - len(text) // 2
            if first >= 0 and (where[row, first : first + len(text)] == number).all():
                labels |= {(row, first + place): letter for place, letter in enumerate(text)}
                break
    return labels


def _colour(part: float) -> tuple[int, int, int]:
    place = min(max(part, 0.0), 1.0) * (len(_COLOURS) - 1)
    lower = min(int(place), len(_COLOURS) - 2)
    rest = place - lower
    a, b = _COLOURS[lower], _COLOURS[lower + 1]
    return tuple(round(x + rest * (y - x)) for x, y in zip(a, b, strict=True))  # pyright: ignore

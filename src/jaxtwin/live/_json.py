"""A record, a finding, and what is known of a rig, as JSON: for a broker, a health file, a page."""

import math
from collections.abc import Sequence
from typing import Any

from .._json_values import json_value
from ..rig import Rig
from .protocol._records import (
    Command,
    Document,
    Event,
    Gap,
    Greeting,
    LinkChange,
    Reading,
    Record,
    Sample,
    StateEstimate,
)
from .protocol._rig_state import RigState
from .safety._interlock import Finding

MILLIKELVIN = 3  # digits of a temperature


def record_as_json(record: Record, rig: Rig) -> dict[str, Any]:
    """A record as a dictionary that JSON can hold.

    **Returns:** `kind` (`reading`, `duty`, `estimate`, `event`, `command`, `document`), `time`, its
    arrival, s since 1970, and what a record of that kind holds: temperatures (degC) by the names of
    channels, None for a channel that has failed, and counts by the names of cells with
    `ambient_degC` where it is measured.
    """
    return {"kind": _kind(record), "time": record.arrival * 1e-9, **_content(record, rig)}


def state_as_json(state: RigState, rig: Rig) -> dict[str, Any]:
    """What is known of a rig as a dictionary that JSON can hold.

    **Returns:** `links`, `temperatures_degC`, `measured` (s since 1970), `faults`, `duty`,
    `ambient_degC`, `owner`, `trip`, `recalibrating` and `counts`.
    """
    names = [channel.name for channel in rig.channels]
    sample = state.sample
    duty = [] if sample is None else rig.driver.duty(sample.pwm).tolist()
    return {
        "links": {name: str(link) for name, link in state.links.items()},
        "temperatures_degC": dict(
            zip(names, map(_number, state.temperatures.tolist()), strict=False)
        ),
        "measured": dict(zip(names, (state.measured * 1e-9).tolist(), strict=False)),
        "faults": {names[place]: why for place, why in state.faults.items()},
        "duty": dict(zip(rig.driven, duty, strict=False)),
        "ambient_degC": state.ambient,
        "owner": "" if sample is None else sample.owner,
        "trip": state.trip,
        "recalibrating": state.recalibrating,
        "counts": dict(state.counts),
    }


def finding_as_json(finding: Finding) -> dict[str, Any]:
    """A finding on a live rig as a dictionary that JSON can hold; its times are s since 1970."""
    names = ("kind", "detail", "channel", "severity", "size", "unit", "probability")
    times = {name: getattr(finding, name) for name in ("since", "found", "until")}
    seconds = {name: None if value is None else value * 1e-9 for name, value in times.items()}
    return {name: json_value(getattr(finding, name)) for name in names} | seconds


def _kind(record: Record) -> str:
    match record:
        case Reading():
            return "reading"
        case Sample():
            return "duty"
        case Command():
            return "command"
        case Document():
            return "document"
        case StateEstimate():
            return "estimate"
    return "event"


def _content(record: Record, rig: Rig) -> dict[str, Any]:
    match record:
        case Reading():
            names: Sequence[str] = [channel.name for channel in rig.channels]
            return dict(zip(names, map(_number, record.temperatures.tolist()), strict=True))
        case Sample():
            counts = dict(zip(rig.driven, record.pwm, strict=False))
            ambient = {} if record.ambient is None else {"ambient_degC": record.ambient}
            return {**counts, **ambient}
        case LinkChange():
            return {"link": record.link, "state": str(record.state)}
        case Gap():
            return {
                "link": record.link,
                "event": "gap",
                "stream": record.stream,
                "count": record.count,
            }
        case Event():
            return {"link": record.link, "event": record.kind, "detail": record.detail}
        case Greeting():
            return {"link": record.link, "rig": record.hello.rig}
        case Command():
            return {"link": record.link, "command": record.kind, "pwm": list(record.pwm)}
        case Document():
            return {"document": record.kind, "uid": record.uid, **record.content}
        case StateEstimate():
            return {"twin": record.twin, **{k: _number(v) for k, v in record.values.items()}}


def _number(value: float) -> float | None:
    """JSON has no NaN, which is the reading of a channel that has failed."""
    return None if math.isnan(value) else round(value, MILLIKELVIN)

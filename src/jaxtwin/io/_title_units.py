"""Units in the titles of columns: one grammar for times, duty cycles, temperatures and the rest.

A unit is read where people and loggers write it:

- in brackets, `T1 [°C]`, `T1 (degF)`, or behind a slash, `T1/K`. These are explicit: nothing else
  can be meant.
- as the last word, `T1_degF`, `bed_kelvin`, `Elapsed ms`, `P_W`; or without a gap, `T1°F`, `tempF`;
  or as the whole title, `ms`. Words that can be nothing else may stand anywhere, `minutes elapsed`.

A letter alone (`zone_F`, `Sensor K`) may be a unit or a name. It is taken for a unit behind a word
for a temperature; elsewhere `is_sure` is False, and whoever reads the column has to say which.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._celsius import ZERO_CELSIUS


@final
class ColumnUnit(NamedTuple):
    """A unit of a column: a number in it is `(number - zero) / per` in the unit of its quantity,
    degC, s, 1, W, V, A, ohm or counts."""

    symbol: str
    quantity: str
    per: float = 1.0
    zero: float = 0.0

    def converted(self, values: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
        """Numbers in this unit, in the unit of the quantity."""
        return (values - self.zero) / self.per if self.zero else values / self.per


def _prefixed(prefixes: str, words: str) -> str:
    return " ".join(prefix + word for prefix in ["", *prefixes.split()] for word in words.split())


_DEGREES = "° deg degree degrees grad °deg"
_SPELLINGS = {
    ColumnUnit("degC", "temperature"): _prefixed(_DEGREES, "c celsius centigrade") + " c° oc",
    ColumnUnit("degF", "temperature", 1.8, 32.0): _prefixed(_DEGREES, "f fahrenheit") + " f° of",
    ColumnUnit("K", "temperature", 1.0, ZERO_CELSIUS): _prefixed(
        "° deg degrees", "k kelvin kelvins"
    ),
    ColumnUnit("mdegC", "temperature", 1e3): "mc m°c mdegc millic millidegc millidegreec "
    "millidegrees millicelsius millidegreescelsius milli°c",
    ColumnUnit("mK", "temperature", 1e3, 1e3 * ZERO_CELSIUS): "mk millikelvin",
    ColumnUnit("s", "time"): "s sec secs second seconds sek sekunde sekunden",
    ColumnUnit("ms", "time", 1e3): "ms msec msecs millis millisec millisecond milliseconds",
    ColumnUnit("us", "time", 1e6): "us µs μs usec usecs micros microsecond microseconds",
    ColumnUnit("ns", "time", 1e9): "ns nsec nanos nanosecond nanoseconds",
    ColumnUnit("min", "time", 1 / 60): "min mins minute minutes minuten",
    ColumnUnit("h", "time", 1 / 3600): "h hr hrs hour hours stunde stunden",
    ColumnUnit("d", "time", 1 / 86400): "d day days tage",
    ColumnUnit("1", "duty"): "1 - fraction ratio on/off bool boolean 0/1 0-1 0..1 duty",
    ColumnUnit("%", "duty", 100.0): "% percent percentage pct prozent %duty",
    ColumnUnit("counts", "counts"): "counts count cts raw lsb digits bits",
    ColumnUnit("W", "power"): "w watt watts",
    ColumnUnit("mW", "power", 1e3): "mw milliwatt milliwatts",
    ColumnUnit("kW", "power", 1e-3): "kw kilowatt kilowatts",
    ColumnUnit("V", "voltage"): "v vdc vac volt volts",
    ColumnUnit("mV", "voltage", 1e3): "mv mvdc millivolt millivolts",
    ColumnUnit("A", "current"): "a adc aac amp amps ampere amperes",
    ColumnUnit("mA", "current", 1e3): "ma madc milliamp milliamps",
    ColumnUnit("ohm", "resistance"): "ohm ohms ω",
    ColumnUnit("kohm", "resistance", 1e-3): "kohm kohms kω",
    ColumnUnit("%RH", "humidity"): "rh %rh rh% %r.h. %r.h",
}
_UNITS = {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}
# The units by their symbols, which names of columns have at their end: `T1_degF`, `time_ms`.
UNITS = {unit.symbol: unit for unit in _SPELLINGS}

# Last words that may be a unit of temperature or part of a name, in small letters.
_LETTERS = frozenset({"c", "f", "k", "mc", "mk", "of", "oc"})

_MEGA = re.compile(r"M(W|V|A|C|K|°C|degC)")
_TEMPERATURE_WORD = re.compile(r"(^|[\W_])t\d*$|temp|therm|(^|[\W_])tc\d*$", re.IGNORECASE)
_BRACKETS = re.compile(r"\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))")
_SLASH = re.compile(r"(.+?)\s*/\s*([^/]+)")
_LAST_WORD = re.compile(
    r"(.+?)(?:[\s_.,;:-]+in)?([\s_.,;:-]+)((?:deg(?:rees?)?[\s_.]+)?[^\s_.,;:]+)\.*", re.IGNORECASE
)
_WITHOUT_GAP = re.compile(r"(.*?)[\s_]*(m?°\s*[CFK])|(.*[Tt]emp(?:erature)?\d*)([CFK]|deg[CFK])")
_ANYWHERE = re.compile(
    r"(m?°\s*[CFK]|deg(?:rees?)?[\s_.]*[CFK]|fahrenheit|kelvin|celsius|%)(?![^\W_])"
    r"|(?<![^\W_])(percent|pct|watts?|volts?|amps?|counts|ms|msecs?|millis|milliseconds?|usecs?|"
    r"micros|microseconds?|mins|minutes?|hours?)(?![^\W_])",
    re.IGNORECASE,
)
_LETTER_INSIDE = re.compile(r"temp(?:erature)?s?[\s_]?([FK])(?![a-z])", re.IGNORECASE)
# The end of a name before a unit that is not the whole unit: `T 0.1°C`.
_FACTOR = re.compile(r"(?<![^\W_])(\d*[.,/]\d+|[x*×]\s*10+)$")


@final
class TitleUnit(NamedTuple):
    """A title without its unit, and the unit.

    - `stem`: the title without it. `unit`: None if there is none, or an unknown one.
    - `text`: the unit as it is written; of a bracket also if it is unknown.
    - `is_explicit`: it stands in brackets or behind a slash.
    - `is_sure`: it cannot be a part of the name.
    """

    stem: str
    unit: ColumnUnit | None = None
    text: str = ""
    is_explicit: bool = False
    is_sure: bool = True


def unit_called(text: str) -> ColumnUnit | None:
    """The unit of any of its spellings; None for an unknown one."""
    plain = text.strip().replace("º", "°").replace("˚", "°").replace("℃", "°C")
    plain = plain.replace("℉", "°F").replace("Â°", "°")
    if _MEGA.fullmatch(plain):
        return None
    return _UNITS.get(re.sub(r"[\s_]|(?<=deg)\.", "", plain.lower()))


def unit_of_title(title: str) -> TitleUnit:
    """Separates a title from its unit."""
    title = title.strip().replace("º", "°").replace("˚", "°").replace("℃", "°C")
    title = title.replace("℉", "°F").replace("Â°", "°")
    brackets = list(_BRACKETS.finditer(title))
    texts = [(bracket[1] or bracket[2] or "").strip() for bracket in brackets]
    for bracket, text in reversed(list(zip(brackets, texts, strict=True))):
        unit = unit_called(text) if text and not text.isdigit() else None
        if unit is not None:
            stem = (title[: bracket.start()] + title[bracket.end() :]).strip()
            return TitleUnit(stem, unit, text or "1", is_explicit=True)
    if brackets and brackets[-1].end() == len(title):
        # An unknown word in brackets may still follow a unit: `T_degF (bed)`.
        stem = title[: brackets[-1].start()].strip()
        inner, text = unit_of_title(stem), texts[-1]
        if inner.unit is not None:
            return inner
        if not text or text.isdigit():  # `heater()`, and a column of pandas that is there twice
            return TitleUnit(stem, UNITS["1"], text or "1", is_explicit=True)
        return TitleUnit(stem, None, text, is_explicit=True)
    parts = next(_without_brackets(title), TitleUnit(title))
    if parts.unit is not None and (factor := _FACTOR.search(parts.stem)):
        return TitleUnit(parts.stem, None, f"{factor[0]} {parts.text}", is_explicit=True)
    return parts


def _without_brackets(title: str) -> Iterator[TitleUnit]:
    whole = unit_called(title)
    if whole is not None and whole.symbol != "1":
        yield TitleUnit("", whole, title, is_sure=title.lower() not in _LETTERS)
    slash = _SLASH.fullmatch(title)
    if slash and (unit := unit_called(slash[2])) is not None:
        yield TitleUnit(slash[1], unit, slash[2], is_explicit=True)
    last = _LAST_WORD.fullmatch(title)
    # The number behind a name, as of `duty_Cell_A.1`, is no unit.
    if last and not last[3].isdigit() and (unit := unit_called(last[3])) is not None:
        stem, gap, text = last.groups()
        is_letter = text.lower() in _LETTERS
        is_name_k = gap == "_" and text in ("K", "C")
        sure = not is_letter or is_name_k or bool(_TEMPERATURE_WORD.search(stem))
        yield TitleUnit(stem, unit, text, is_sure=sure)
    glued = _WITHOUT_GAP.fullmatch(title)
    if glued:
        stem, text = (glued[1], glued[2]) if glued[2] else (glued[3], glued[4])
        yield TitleUnit(stem, unit_called(text), text)
    if anywhere := _ANYWHERE.search(title):
        stem = (title[: anywhere.start()] + title[anywhere.end() :]).strip(" _-/")
        yield TitleUnit(stem, unit_called(anywhere[0]), anywhere[0])
    if inside := _LETTER_INSIDE.search(title):
        yield TitleUnit(title, unit_called(inside[1]), inside[1], is_sure=False)

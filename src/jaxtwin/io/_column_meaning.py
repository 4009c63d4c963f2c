"""What one column means: its kind, its name, and the unit of its numbers, from its title and from
what a reader of the file says about it."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal, NamedTuple, TypeAlias, final

from .._arguments import is_ordered, mapping_of
from ..errors import RecordingError
from ..rig import Rig
from ._timestamps import is_timestamp_title
from ._title_units import UNITS, ColumnUnit, TitleUnit, unit_called, unit_of_title

# German names of columns, in small letters, and the names by which they are read.
WORDS = {
    "zeit": "time",
    "uhrzeit": "time",
    "zeitstempel": "timestamp",
    "datum": "date",
    "datum/uhrzeit": "date/time",
    "datum/zeit": "date/time",
    "umgebung": "ambient",
    "umgebungstemperatur": "ambient",
    "raumtemperatur": "ambient",
}

# The name of the drive of a cell that is called by its number.
CELL = re.compile(r"(duty|pwm)_P([1-9]\d{0,3})")

# The name of the drive of a cell or heater.
DRIVE = re.compile(r"(duty|pwm)_(.+)")

# The same where no rig tells which names there are.
_DRIVE_WITHOUT_RIG = re.compile(r"(duty|pwm)_(?!(?:cycle|percent|pct)$)[^\W\d][\w.-]*")

# The name of an input besides the duty.
INPUT = re.compile(r"input_([^\W\d]\w*)")

Kind: TypeAlias = Literal["time", "own time", "duty", "pwm", "input", "temperature", "unknown"]

# The quantity of each kind of column. Inputs have the quantity of the rig's unit.
QUANTITIES: dict[Kind, str] = {
    "time": "time",
    "own time": "time",
    "duty": "duty",
    "pwm": "counts",
    "temperature": "temperature",
}

# The unit of a column that a reader has named, where neither title nor name states one.
DEFAULT_UNITS: dict[Kind, str] = {"duty": "1", "pwm": "counts", "temperature": "degC"}

# The title of a channel in a file of this program.
_WRITTEN = re.compile(r"(.+)_(degC|K)")

# Last words that are parts of a name, unless the column is one of times.
_OF_NAMES = frozenset({"s", "h", "d", "min"})

_SCALE = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)(?:\s*/\s*([\d.]+(?:[eE][-+]?\d+)?))?(.*)")


@final
class Meaning(NamedTuple):
    """What a column is read as.

    - `title`: its title in the file. `name`: its name without the unit, such as `T1`.
    - `unit`: the unit of its numbers; None without one, as of time stamps.
    - `scale`: the factor that makes numbers in this unit of those in the file.
    """

    title: str
    kind: Kind
    name: str
    unit: ColumnUnit | None = None
    scale: float = 1.0

    @property
    def text(self) -> str:
        """The name with the unit behind an underscore, `T1_degC`, as a title states it."""
        if self.kind == "unknown" or self.unit is None or self.unit.symbol in ("1", "counts"):
            return self.name
        return f"{self.name}_{self.unit.symbol}"


@final
@dataclass(frozen=True)
class Choices:
    """What a reader of a file says about its columns; the fields are those of `read_recording`."""

    columns: Mapping[str, str] = field(default_factory=dict)
    ignore: Sequence[str] = ()
    scale: Mapping[str, str] = field(default_factory=dict)
    rig: Rig | None = None

    def __post_init__(self) -> None:
        mapping_of("columns", self.columns, "title in the file -> name", RecordingError)
        mapping_of("scale", self.scale, "name -> factor and unit, '1/2220 W'", RecordingError)
        if not is_ordered(self.ignore) or not all(isinstance(p, str) for p in self.ignore):
            raise RecordingError(f"ignore: expected a list of titles, got {self.ignore!r}")

    @property
    def rig_titles(self) -> dict[str, str]:
        """The titles of columns to which a rig gives a meaning: its inputs by their names, and the
        duty and counts of its cells and heaters, or their `power`, `voltage` or `current` if the
        rig says what that is at full duty."""
        if self.rig is None:
            return {}
        titles = {rig_input.name: f"input_{rig_input.name}" for rig_input in self.rig.inputs}
        numbers = [f"P{number}" for number in range(1, len(self.rig.driven) + 1)]
        for called in (*self.rig.driven, *numbers):
            name = self.rig.driven_called(called)
            if name is not None:
                titles |= {f"{kind}_{called}": f"{kind}_{name}" for kind in ("duty", "pwm")}
                if name in self.rig.full_scales:
                    quantity = UNITS[self.rig.full_scales[name][1]].quantity
                    titles[f"{quantity}_{called}"] = f"duty_{name}"
        return titles

    def full_scale(self, name: str) -> tuple[float, ColumnUnit] | None:
        """What a column has at full duty, by the rig; None for a rig that does not say it."""
        drive = DRIVE.fullmatch(name)
        scales = {} if self.rig is None else self.rig.full_scales
        if drive is None or drive[1] != "duty" or drive[2] not in scales:
            return None
        number, unit = scales[drive[2]]
        return number, UNITS[unit]

    @property
    def scales(self) -> dict[str, str]:
        """`scale` by the names that columns are read as."""
        titles = self.rig_titles
        return {titles.get(name, name): text for name, text in self.scale.items()}

    def is_of_rig(self, meaning: Meaning) -> bool:
        """Whether a column is one of the rig's, which is True of any without a rig."""
        if self.rig is None or meaning.kind in ("time", "own time"):
            return True
        if meaning.kind in ("duty", "pwm"):
            return meaning.name in self.rig_titles.values()
        if meaning.kind == "input":
            return meaning.name.removeprefix("input_") in [
                rig_input.name for rig_input in self.rig.inputs
            ]
        return meaning.name in ["ambient", *(channel.name for channel in self.rig.channels)]

    def unit_of_input(self, name: str) -> str | None:
        """The unit of an input in the rig file; None without a rig, or of one with states."""
        inputs = () if self.rig is None else self.rig.inputs
        return next(
            (rig_input.unit for rig_input in inputs if f"input_{rig_input.name}" == name), None
        )


def _kind(name: str, choices: Choices) -> Kind:
    """The kind of a column of a name without its unit, unless it is a temperature."""
    drive = CELL.fullmatch(name)
    if drive is None and name in choices.rig_titles.values():
        drive = DRIVE.fullmatch(name)
    if drive is not None:
        return "duty" if drive[1] == "duty" else "pwm"
    if INPUT.fullmatch(name):
        return "input"
    if is_timestamp_title(name):
        return "own time" if name.lower().endswith("_time") and len(name) > 5 else "time"
    return "temperature"


def meaning_of_title(title: str, choices: Choices) -> Meaning:
    """What a title without a name is read as."""
    if written := _WRITTEN.fullmatch(title):  # whatever the channel is called
        return _scaled(Meaning(title, "temperature", written[1], UNITS[written[2]]), choices)
    whole = choices.rig_titles.get(title, title)
    if (kind := _kind(whole, choices)) in ("time", "own time"):
        return Meaning(title, kind, "time" if kind == "time" else title)
    if kind != "temperature":  # the last letter of `input_a` is no unit
        return meaning_of_name(title, whole, choices, TitleUnit(title))
    parts = unit_of_title(title)
    stem = choices.rig_titles.get(parts.stem, parts.stem)
    kind, unit = _kind(stem, choices), parts.unit
    if kind == "temperature" and (drive := _drive_without_rig(title, parts, choices)):
        return meaning_of_name(title, drive, choices, parts if drive != title else TitleUnit(title))
    if kind == "temperature":
        is_known = unit is not None and unit.quantity == "temperature" and parts.is_sure and stem
        return _scaled(
            Meaning(title, "temperature" if is_known else "unknown", stem, unit), choices
        )
    if kind in ("time", "own time") and unit is not None and unit.quantity != "time":
        return Meaning(title, "unknown", parts.stem, unit)
    return meaning_of_name(title, stem, choices)


def meaning_of_name(
    title: str, given: object, choices: Choices, parts: TitleUnit | None = None
) -> Meaning:
    """What a column is read as that has a name."""
    if not isinstance(given, str) or not given:
        raise RecordingError(f"columns: expected a name for {title!r}, got {given!r}")
    called, given = given, choices.rig_titles.get(given, given)
    name, stated = _name_and_unit(given, choices)
    kind = _kind(name, choices)
    if kind == "temperature" and (drive := _drive_without_rig(name, TitleUnit(name), choices)):
        kind = "duty" if drive.startswith("duty") else "pwm"
    if parts is None:
        # A title that is the name, such as `T_C` of a rig with the channel `T_C`, has no unit.
        parts = TitleUnit(title) if title.lower() == name.lower() else unit_of_title(title)
    meaning = Meaning(title, kind, "time" if kind == "time" else name, stated)
    by_rig = _by_full_scale(meaning, parts, (title, called, parts.stem), choices)
    if name in choices.scales:
        scaled = _scaled(meaning._replace(unit=parts.unit or stated), choices)
        if by_rig is not None and not math.isclose(by_rig.scale, scaled.scale, rel_tol=1e-6):
            raise RecordingError(
                f"column {title}: expected the full_scale of the rig file, a factor of "
                f"{by_rig.scale:.6g}, got a scale of {choices.scales[name]!r}; remove one of them"
            )
        return scaled
    if by_rig is not None:
        return by_rig
    if kind == "input":
        return _of_input(meaning, parts, choices)
    return meaning._replace(unit=_unit(meaning, parts, stated))


def _by_full_scale(
    meaning: Meaning, parts: TitleUnit, names: tuple[str, ...], choices: Choices
) -> Meaning | None:
    """A column of the power, voltage or current of a cell or heater, as a share of what the rig
    says of full duty; None for another column.

    **Raises:** `RecordingError` for another of these quantities than the rig's.

    **Arguments:**

    - `parts`: its title. `names`: by which it is called, such as `power_P1`.
    """
    full = choices.full_scale(meaning.name)
    if full is None:
        return None
    number, of_rig = full
    unit = parts.unit or meaning.unit
    if unit is None and any(name.startswith(f"{of_rig.quantity}_") for name in names):
        unit = of_rig
    if unit is None or unit.quantity not in ("power", "voltage", "current"):
        return None
    if unit.quantity != of_rig.quantity:
        raise RecordingError(
            f"column {meaning.title}: expected {of_rig.symbol}, the unit of the full_scale in the "
            f"rig file, got {unit.symbol} ({unit.quantity})"
        )
    return meaning._replace(unit=UNITS["1"], scale=1 / (number * unit.per))


def _name_and_unit(given: str, choices: Choices) -> tuple[str, ColumnUnit | None]:
    """A name that a reader has given without its unit, and the unit, if it states one."""
    channels = [] if choices.rig is None else [channel.name for channel in choices.rig.channels]
    parts = unit_of_title(given)
    unit, stem = parts.unit, choices.rig_titles.get(parts.stem, parts.stem)
    if given in channels or _kind(given, choices) != "temperature" or unit is None:
        return given, None
    drive = _drive_without_rig(given, parts, choices)
    if drive == given:
        return given, None
    if not parts.is_explicit and parts.text != unit.symbol:
        return given, None
    quantity = QUANTITIES.get(_kind(stem, choices), "")
    if drive is not None:
        stem, quantity = drive, "duty" if drive.startswith("duty") else "counts"
    if unit.quantity == quantity or (unit.symbol == "1" and parts.is_explicit):
        return stem, unit if unit.quantity == quantity else None
    raise RecordingError(
        f"columns: expected a name such as time_s, duty_P1, T1 or T1_degC, got {given!r}"
    )


def _drive_without_rig(title: str, parts: TitleUnit, choices: Choices) -> str | None:
    """The name of the drive of a cell or heater that no rig lists, `duty_foil`: the title, or what
    it has before a unit of duty; None if it is none."""
    is_share = parts.unit is not None and parts.unit.quantity == "duty"
    name = parts.stem if is_share else title
    is_name = choices.rig is None and (is_share or not parts.is_explicit)
    return name if is_name and _DRIVE_WITHOUT_RIG.fullmatch(name) else None


def _unit(meaning: Meaning, parts: TitleUnit, stated: ColumnUnit | None) -> ColumnUnit | None:
    """The unit of a column that has a name: that of its title, or else that of its name.

    **Raises:** `RecordingError` if the title has a unit of another quantity, or a last letter that
    may be a unit or not.
    """
    quantity, unit, text = QUANTITIES[meaning.kind], parts.unit, parts.text
    default = stated or UNITS.get(DEFAULT_UNITS.get(meaning.kind, ""))
    title = f"column {meaning.title}"
    if unit is None and not text:
        return default
    if unit is None:
        # The remark of a column of times may be a form or a zone: `Time (hh:mm)`, `Time (UTC)`.
        if stated is not None or quantity == "time":
            return stated
        raise RecordingError(
            f"{title}: expected a known unit of {_words(meaning)}, got {text!r}; if this is none, "
            f"name the column {_example(meaning)}, and if it is one, say what it means: "
            f"scale={{{meaning.name!r}: '0.1'}}, in a command --scale {meaning.name}=0.1"
        )
    if unit.symbol == "1" and quantity != "duty":
        return default
    if unit.quantity == quantity:
        if parts.is_sure:
            return unit
        if stated is None:
            raise RecordingError(
                f"{title}: expected a unit or a name without doubt, got {text!r} at its end, which "
                f"may be either; name the column {meaning.name}_{unit.symbol} or "
                f"{_example(meaning)}"
            )
        return stated
    # `T_min` is the lowest temperature and `cell_C` a cell; `zone_A` may also be a current.
    is_of_name = text in _OF_NAMES or (text in "CFK" and quantity != "temperature")
    if not parts.is_explicit and (stated is not None or is_of_name):
        return default
    scale = f"1/12 {unit.symbol}"
    hint = {
        "duty": f"; say what full duty is: scale={{{meaning.name!r}: {scale!r}}}, in a command "
        f"--scale '{meaning.name}={scale}'",
        "counts": f"; a share of full duty is called {meaning.name.replace('pwm', 'duty')}",
    }.get(quantity, "")
    if not parts.is_explicit:
        hint += f"; if it is a part of the name, name the column {_example(meaning)}"
    raise RecordingError(
        f"{title}: expected a unit of {_words(meaning)}, got {unit.symbol} ({unit.quantity}){hint}"
    )


def _words(meaning: Meaning) -> str:
    quantity = {"duty": "duty, % or none", "counts": "PWM, counts or none"}
    return f"{quantity.get(QUANTITIES[meaning.kind], QUANTITIES[meaning.kind])} for {meaning.name}"


def _example(meaning: Meaning) -> str:
    return {"time": "time_s", "temperature": f"{meaning.name}_degC"}.get(
        meaning.kind, f"'{meaning.name} [-]'"
    )


def _of_input(meaning: Meaning, parts: TitleUnit, choices: Choices) -> Meaning:
    """What the column of an input is read as: in the unit of the rig file."""
    of_rig = choices.unit_of_input(meaning.name)
    unit = parts.unit
    is_same = parts.text.lower() in ("", "1", "-", (of_rig or "").lower())
    if is_same or (not parts.is_explicit and (unit is None or len(parts.text) == 1)):
        return meaning
    target = UNITS["1"] if of_rig == "" else unit_called(of_rig or "")
    if unit is not None and target is not None and unit.quantity == target.quantity:
        # From the column's unit to that of the rig: x -> (x - zero) / per * per_rig + zero_rig.
        if target == unit:
            return meaning
        per = unit.per / target.per
        return meaning._replace(
            unit=ColumnUnit(unit.symbol, "", per, unit.zero - target.zero * per)
        )
    if of_rig is None and unit is not None and unit.per == 1 and not unit.zero:
        return meaning
    if not parts.is_explicit and (unit is None or unit.quantity == "time"):
        return meaning
    raise RecordingError(
        f"column {meaning.title}: expected the unit of {meaning.name} in the rig file, "
        f"{of_rig if of_rig is not None else 'which rig= gives'}, got {parts.text!r}"
    )


def _scaled(meaning: Meaning, choices: Choices) -> Meaning:
    """A column with the scale that a reader of the file states for its name."""
    text = choices.scales.get(meaning.name)
    if text is None:
        return meaning
    parts = _SCALE.fullmatch(text) if isinstance(text, str) else None
    word = parts[3].strip() if parts else ""
    unit = unit_called(word) if word else None
    try:
        factor = Fraction(parts[1]) / Fraction(parts[2] or 1) if parts else Fraction(0)
    except (ValueError, ZeroDivisionError):
        factor = Fraction(0)
    if not factor or (word and unit is None):
        raise RecordingError(
            f"scale: expected a factor and the unit of the column for {meaning.name}, such as "
            f"'1/2220 W' or '0.1', got {text!r}"
        )
    of_title = meaning.unit
    is_temperature = meaning.kind == "temperature" and (unit or of_title or UNITS["degC"])
    if of_title is not None and (unit or of_title).quantity != of_title.quantity:
        raise RecordingError(
            f"column {meaning.title}: expected a scale in {of_title.symbol}, got {text!r}"
        )
    if is_temperature and is_temperature.quantity == "temperature":
        return meaning._replace(unit=of_title or is_temperature, scale=float(factor))
    per = unit.per / of_title.per if unit is not None and of_title is not None else 1.0
    after = UNITS.get({**DEFAULT_UNITS, "time": "s"}.get(meaning.kind, ""))
    return meaning._replace(unit=after, scale=float(factor) * per)


def in_english(title: str) -> str:
    """A title whose first word is German, by its English name; others as they are."""
    word = re.match(r"[A-Za-zÄÖÜäöüß]+(?:/[A-Za-z]+)?", title)
    if word is None or word[0].lower() not in WORDS:
        return title
    rest = title[word.end() :]
    return (
        title
        if re.match(r"[ ]*\w", rest) and not rest.startswith("_")
        else (WORDS[word[0].lower()] + rest)
    )

"""The file of a fleet: its broker, and groups of rigs."""

import re
from pathlib import Path
from typing import Annotated, NamedTuple, final

from pydantic import Field

from ..errors import LinkError
from ..live import MqttAddress
from ..rig import Format, SchemaTable, Text, read_toml, refuse, validate

# What a name of a rig may be: it is a level of a topic, a part of an address and a label.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")

_RANGE = re.compile(r"(.*)\{(\d{1,6})\.\.(\d{1,6})\}(.*)")

# The largest number of rigs of a file.
MAX_RIGS = 20_000


class GroupTable(SchemaTable):
    """Rigs that have the same rig file; `{rig}` in a path is the name of each."""

    rig: Text
    members: Annotated[list[Text], Field(min_length=1)]
    parameters: Text | None = None
    store: Text | None = None
    noise: Text | None = None
    calibration: Text | None = None
    sample_time_s: Annotated[float, Field(ge=0.1, le=60)] = 1.0


class FleetTable(SchemaTable):
    """The whole file."""

    format: Format
    broker: Text
    pattern: Text = "{rig}"
    journal: Text = "fleet.db"
    keep_days: Annotated[float, Field(gt=0, le=3650)] = 7.0
    silence_s: Annotated[float, Field(ge=1, le=86_400)] = 10.0
    alarm: Text | None = None
    dask: Text | None = None
    groups: Annotated[dict[str, GroupTable], Field(min_length=1)]


@final
class Member(NamedTuple):
    """A rig of a fleet, and the files from which its twin is made.

    - `rig`: a rig file, or the name of a bundled rig.
    - `sample_time`: the time between two readings that are used, s.
    """

    name: str
    group: str
    rig: str
    parameters: Path | None
    store: Path | None
    noise: Path | None
    calibration: Path | None
    sample_time: float

    @property
    def files(self) -> tuple[tuple[str, int], ...]:
        """The files with the time of their last change, ns: other ones make another twin."""
        paths = (Path(self.rig), self.parameters, self.store, self.noise, self.calibration)
        return tuple(
            (str(path), path.stat().st_mtime_ns) for path in paths if path and path.is_file()
        )


@final
class FleetFile(NamedTuple):
    """What a file of a fleet says.

    - `broker`: the address, whose topic stands before those of all rigs.
    - `pattern`: the levels behind it, in which `{rig}` is the name of a rig.
    - `members`: name -> rig.
    """

    broker: MqttAddress
    url: str
    pattern: str
    journal: Path
    keep_days: float
    silence: float
    alarm: str | None
    dask: str | None
    members: dict[str, Member]

    @classmethod
    def read(cls, path: Path) -> "FleetFile":
        """Reads a file.

        **Raises:** `RigError` that names the file, the field and what is allowed.
        """
        data, source = read_toml(path)
        table = validate(FleetTable, data, source)
        try:
            broker = MqttAddress.parse(table.broker)
        except LinkError as problem:
            refuse(source, "broker", str(problem).removeprefix("link: "))
        levels = table.pattern.split("/")
        if levels.count("{rig}") != 1 or not all(
            NAME.fullmatch(level.strip("{}")) for level in levels
        ):
            refuse(
                source,
                "pattern",
                "expected levels of a topic of which one is {rig}, such as hall/{rig}/json, got "
                f"{table.pattern!r}",
            )
        folder = path.absolute().parent
        members: dict[str, Member] = {}
        for name, group in table.groups.items():
            for member in _members(source, name, group, folder):
                if member.name in members:
                    refuse(
                        source,
                        f"groups.{name}.members",
                        f"expected each rig once, got {member.name!r} again",
                    )
                members[member.name] = member
        if len(members) > MAX_RIGS:
            refuse(source, "groups", f"expected at most {MAX_RIGS} rigs, got {len(members)}")
        return cls(
            broker,
            table.broker,
            table.pattern,
            folder / table.journal,
            table.keep_days,
            table.silence_s,
            table.alarm,
            table.dask,
            members,
        )

    def topic(self, rig: str, what: str) -> str:
        """The topic of a rig, such as that of its `readings`."""
        return f"{self.broker.topic}/{self.pattern.replace('{rig}', rig)}/{what}"


def _members(source: str, group: str, table: GroupTable, folder: Path) -> list[Member]:
    where = f"groups.{group}"
    if table.store is not None and table.parameters is not None:
        refuse(source, f"{where}.store", "expected either store or parameters, got both")
    names = [name for text in table.members for name in _names(source, where, text)]

    def path(field: str, name: str) -> Path | None:
        text = getattr(table, field)
        if text is None:
            return None
        file = folder / text.replace("{rig}", name)
        if not file.is_file():
            refuse(source, f"{where}.{field}", f"expected a file, got {str(file)!r}")
        return file

    rig_file = folder / table.rig
    return [
        Member(
            name,
            group,
            str(rig_file) if rig_file.is_file() else table.rig,
            path("parameters", name),
            path("store", name),
            path("noise", name),
            path("calibration", name),
            table.sample_time_s,
        )
        for name in names
    ]


def _names(source: str, where: str, text: str) -> list[str]:
    """The names that an entry such as `oven-{001..250}` stands for."""
    parts, names = _RANGE.fullmatch(text), [text]
    if parts is not None:
        begin, end = int(parts[2]), int(parts[3])
        if not 0 <= end - begin < MAX_RIGS:
            refuse(
                source, f"{where}.members",
                f"expected a range of 1 to {MAX_RIGS} rigs, got {text!r}",
            )  # fmt: skip
        width = len(parts[2])
        names = [f"{parts[1]}{number:0{width}d}{parts[4]}" for number in range(begin, end + 1)]
    for name in names:
        if not NAME.fullmatch(name):
            refuse(
                source,
                f"{where}.members",
                "expected names of letters, digits and - _ . such as oven-1 or oven-{001..250}, "
                f"got {name!r}",
            )
    return names

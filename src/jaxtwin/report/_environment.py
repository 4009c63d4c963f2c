"""The machine and the versions with which a report was computed, and the files beside it."""

from ..doctor import examine
from ._blocks import ReportTable, Section, Text


def files_table(files: dict[str, str]) -> ReportTable:
    """The files beside the page.

    **Arguments:**

    - `files`: name -> contents.
    """
    return ReportTable("Files beside this page.", ("file", "what it holds"), list(files.items()))


def environment_section(wall_time: float) -> Section:
    """Versions, devices and settings.

    **Arguments:**

    - `wall_time`: the computing time of the whole report so far, s.
    """
    tables = tuple(
        ReportTable(section[0].upper() + section[1:] + ".", ("", ""), list(entries.items()))
        for section, entries in examine().items()
    )
    return Section(
        "Environment",
        (Text(f"This report took {wall_time:.0f} s. `jaxtwin doctor` prints this list:"), *tables),
    )

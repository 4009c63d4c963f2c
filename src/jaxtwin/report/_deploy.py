"""Step 5 of the paper: what to go on with; and what all this ran on."""

from ..doctor import examine
from ._blocks import Section, Table, Text


def deploy(files: dict[str, str]) -> Section:
    """What lies beside the page and what takes it.

    **Arguments:**

    - `files`: name -> what it holds.
    """
    return Section(
        "5 Deploy: what to go on with",
        (
            Text(
                "The matched twin is a file of parameters in the form of a rig file's own table. "
                "Every command takes it, and so does `jaxtwin.read_parameters`:"
            ),
            Text(
                "`jaxtwin simulate paper-2024 --parameters fit-ambient-per-recording.toml --duty "
                "0:0.5,500:0.78 --duration 1000 --out run.nc`"
            ),
            Table("Beside this page.", ("file", "what it holds"), list(files.items())),
        ),
    )


def environment(wall_time: float) -> Section:
    """Versions, devices and settings.

    **Arguments:**

    - `wall_time`: of the whole demo so far, s.
    """
    tables = tuple(
        Table(section[0].upper() + section[1:] + ".", ("", ""), list(entries.items()))
        for section, entries in examine().items()
    )
    return Section(
        "Environment",
        (Text(f"Everything above took {wall_time:.0f} s (`jaxtwin doctor` prints this):"), *tables),
    )

"""Where the bundled rigs, modules, materials, tables and synthetic recordings are."""

from pathlib import Path

_PACKAGE = Path(__file__).parent


def data_folder() -> Path:
    """The folder of the bundled data files.

    An installed wheel carries it inside the package. An editable install reads `data/` of its
    checkout, so that a file that is changed there is the one that is used.
    """
    carried = _PACKAGE / "_data"
    return carried if carried.is_dir() else _PACKAGE.parents[1] / "data"

"""Reading rig files."""

import os
from collections.abc import Mapping
from typing import Any

from .._arguments import path_of
from .._name_suggestions import unknown_name
from .._twin_address import TwinAddress, read_stored_fit, twin_address
from ..errors import RigError
from ._bundled import bundled_content, bundled_rigs, file_content, parse_toml
from ._problems import refuse
from ._rig import Rig


def load_rig(name_or_path: str | os.PathLike[str]) -> Rig:
    """Reads a rig file and checks it.

    **Arguments:**

    - `name_or_path`: the name of a bundled rig (`bundled_rigs()`), or the path of a rig file.

    **Returns:** the rig, with all values in SI units except those of the parameter table, which
    keeps its units.

    **Raises:** `RigError` for the first mistake, naming file, field, what was expected and what
    was found.
    """
    from ._build import parse_rig  # with pydantic, which only readers of a rig should pay for

    if twin_address(name_or_path) is not None:
        refuse(
            os.fspath(name_or_path),
            "",
            "expected a rig, got a twin of a store, which is a rig with values; Twin(address) and "
            "Fit.load(address) read it, and --parameters takes its values, beside the rig",
        )
    place = path_of("load_rig", name_or_path, RigError)
    name = os.fspath(name_or_path)
    if name in bundled_rigs():
        return parse_rig(*bundled_content("rigs", name))
    if not place.exists():
        refuse(name, "", f"no such file, {unknown_name('bundled rig', name, bundled_rigs())}")
    content, source = file_content(place)
    data = parse_toml(content, source)
    if "parameters" in data and not {"plate", "cells", "driver", "channels"} & data.keys():
        refuse(
            source,
            "",
            "expected a rig file, got a parameter file, such as a saved fit; Fit.load reads a fit, "
            "and Twin(rig, file) or --parameters takes its values, beside the rig that it is of",
        )
    return parse_rig(content, source)


def rig_from_tables(tables: Mapping[str, Any], source: str) -> Rig:
    """The rig that the tables of a rig file describe, for a program that writes or changes them.

    The rig has no `text`: a saved fit of it does not hold its rig file, and neither its grid nor
    the places of its cells can be changed afterwards.

    **Arguments:**

    - `tables`: tables, lists and texts as `tomllib.loads` reads them.
    - `source`: what error messages call the rig file.

    **Raises:** `RigError` for the first mistake, as `load_rig` does.
    """
    from ._build import build_rig

    return build_rig(dict(tables), source)


def rig_of_stored_twin(address: TwinAddress) -> Rig:
    """The rig of a twin in a store, from the text of its rig file.

    **Raises:** `RigError` if the store has no such twin.
    """
    from ._build import parse_rig

    source = f"{address.file}@{address.name}"
    data = parse_toml(read_stored_fit(address, RigError), source)
    return parse_rig(data["fit"]["rig_text"].encode(), data["fit"]["rig_file"])

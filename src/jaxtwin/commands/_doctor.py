"""`jaxtwin doctor`: the machine and the versions with which jaxtwin runs."""

import textwrap

from ._options import JsonOption
from ._output import STDOUT, check_json, write_json


def doctor(json: JsonOption = None) -> None:
    """Show versions, devices, precision, cache, recordings and known traps."""
    from ..doctor import examine

    check_json(json)
    findings = examine()
    if json != STDOUT:
        for section, entries in findings.items():
            print(section)
            width = max(map(len, entries))
            for name, text in entries.items():
                label = f"  {name.ljust(width)}  "
                print(textwrap.fill(text, 100, initial_indent=label,
                                    subsequent_indent=" " * len(label),
                                    break_on_hyphens=False, break_long_words=False))  # fmt: skip
    write_json(json, findings)

"""What a benchmark leaves behind: its numbers, and a page about them."""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def parser_of(description: str | None) -> argparse.ArgumentParser:
    """Returns a parser of arguments that knows where the results go, `--out`."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    return parser


def write_results(numbers: Path, answer: Mapping[str, Any], page: str) -> None:
    """Writes the numbers as JSON and the page beside them as Markdown, and prints the page."""
    numbers.parent.mkdir(parents=True, exist_ok=True)
    numbers.write_text(json.dumps(answer, indent=1) + "\n")
    numbers.with_suffix(".md").write_text(page)
    print(page)

"""The reference of the command line, from the code of the commands."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer.main

from jaxtwin.cli import app

ABOUT = """\
This page is generated from the code of the commands; `jaxtwin COMMAND --help` says the same. The
page [Commands](../commands.md) shows in which order they are used, and what the exit codes
mean.""".splitlines()

_MARKUP = re.compile(r"\[/?[a-z ]*\]")


def write(page: Path) -> None:
    """Writes the page."""
    root: Any = typer.main.get_command(app)
    lines = ["# Command line", "", *ABOUT]
    commands = list(_commands(root, "jaxtwin"))
    lines += ["", "| command | |", "|---|---|"]
    for name, command in commands:
        first = _cell(_plain(command.help).partition("\n\n")[0])
        lines.append(f"| [`{name}`](#{name.replace(' ', '-')}) | {first} |")
    for name, command in commands:
        lines += ["", *_section(name, command)]
    page.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _commands(group: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Every command with its whole name, in the order of `--help`."""
    for word, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from _commands(command, f"{name} {word}")
        else:
            yield f"{name} {word}", command


def _section(name: str, command: Any) -> list[str]:
    context = command.make_context(name, [], resilient_parsing=True)
    usage = " ".join(command.collect_usage_pieces(context))
    lines = [f"## `{name}`", "", _plain(command.help), "", "```", f"{name} {usage}", "```", ""]
    lines += ["| argument or option | |", "|---|---|"]
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is None:  # the old name of an option
            continue
        names, text = record
        shown = f"`{names}`" if not parameter.required else f"**`{names}`**"
        lines.append(f"| {shown} | {_cell(text)} |")
    examples = [line.strip() for line in _plain(command.epilog).splitlines() if line.strip()]
    if examples:
        lines += ["", "```", *examples[1:], "```"]
    return lines


def _cell(text: str) -> str:
    """A text as a cell of a table."""
    return " ".join(_plain(text).split()).replace("|", "\\|")


def _plain(text: str | None) -> str:
    """A help text without the markup of the terminal."""
    return _MARKUP.sub("", text or "").strip()

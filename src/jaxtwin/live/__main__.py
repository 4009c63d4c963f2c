"""`python -m jaxtwin.live`: the commands of the live rig alone."""

import sys

import typer

from .._errors import JaxtwinError
from ._commands import add_commands

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)
add_commands(app)

if __name__ == "__main__":
    try:
        app()
    except JaxtwinError as error:
        typer.echo(f"jaxtwin: {error}", err=True)
        sys.exit(2)

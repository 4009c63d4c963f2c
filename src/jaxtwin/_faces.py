"""The face of a package: the names that it offers, each imported when it is first used."""

import ast
from collections.abc import Callable
from pathlib import Path

import lazy_loader

# Heads the second part of a stub.
FOR_PACKAGES = "# For the other packages of jaxtwin: no part of the public interface."


def attach(
    package: str, file: str
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package, by its stub `__init__.pyi`.

    The first part of the stub lists the public names. The line `FOR_PACKAGES` heads the second, the
    names that other packages of jaxtwin import besides: they are found like the public ones, but
    `__all__` and `dir()` leave them out.

    **Arguments:** `__name__` and `__file__` of the package.
    """
    find, _, _ = lazy_loader.attach_stub(package, file)
    stub = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    imports = ast.parse(stub.partition(FOR_PACKAGES)[0]).body
    public = sorted(
        alias.name for node in imports if isinstance(node, ast.ImportFrom) for alias in node.names
    )
    return find, public.copy, public

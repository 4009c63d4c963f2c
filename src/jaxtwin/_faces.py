"""The face of a package: the names that it offers, each imported when it is first used."""

import ast
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import lazy_loader

# Heads the second part of a stub.
FOR_PACKAGES = "# For the other packages of jaxtwin: no part of the public interface."


def attach(
    package: str, file: str, renamed: Mapping[str, str] = MappingProxyType({})
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package, by its stub `__init__.pyi`.

    The first part of the stub lists the public names. The line `FOR_PACKAGES` heads the second, the
    names that other packages of jaxtwin import besides: they are found like the public ones, but
    `__all__` and `dir()` leave them out.

    **Arguments:**

    - `package`, `file`: `__name__` and `__file__` of the package.
    - `renamed`: deprecated name -> the name of now; the deprecated ones warn, and go with the next
      version.
    """
    find_now, _, _ = lazy_loader.attach_stub(package, file)
    stub = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    imports = ast.parse(stub.partition(FOR_PACKAGES)[0]).body  # each line is `import X as X`
    public = sorted(
        alias.name for node in imports if isinstance(node, ast.ImportFrom) for alias in node.names
    )

    def find(name: str) -> object:
        if name not in renamed:
            return find_now(name)
        now = renamed[name]
        warnings.warn(f"{package}.{name} is now {package}.{now}", DeprecationWarning, stacklevel=2)
        return find_now(now)

    return find, public.copy, public  # `__dir__` returns a list of its own

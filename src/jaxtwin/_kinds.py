"""Classes that files name by their `kind`: controllers, losses, sensors, and those of a user."""

from typing import TypeVar

from .errors import JaxtwinError

Class = TypeVar("Class", bound=type)


def add_kind(
    kinds: dict[str, Class], new: Class, where: str, files: str, error: type[JaxtwinError]
) -> None:
    """Adds a class to those that files may name.

    **Arguments:**

    - `kinds`: kind -> class, which is changed.
    - `where`: the function that is called, for messages. `files`: the files, with an example.

    **Raises:** `error` for a class without a `kind`, or with the `kind` of another class.
    """
    kind = getattr(new, "kind", None)
    if not isinstance(kind, str) or not kind:
        raise error(f"{where}: {new.__name__}.kind: expected its name in {files}, got {kind!r}")
    known = kinds.get(kind, new)
    # The same class may be defined again, as when a cell of a notebook runs twice.
    if (known.__module__, known.__qualname__) != (new.__module__, new.__qualname__):
        raise error(
            f"{where}: {new.__name__}.kind: expected a name that is not taken, got {kind!r} of "
            f"{known.__name__}"
        )
    kinds[kind] = new

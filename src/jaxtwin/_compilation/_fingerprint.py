"""Digests of values that mean the same in every process."""

import enum
import functools
import hashlib
import os
import platform
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from importlib import metadata
from pathlib import Path
from types import BuiltinFunctionType, FunctionType
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import numpy as np

# Types whose `repr` describes the value completely.
PLAIN = (type(None), bool, int, float, complex, str, bytes, enum.Enum, np.dtype)

# The libraries on which compiled code depends, beside this package.
LIBRARIES = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")

# Packages whose functions and classes are identified by their names, because `surroundings`
# contains their versions. A user's own code may change and keep its name.
KNOWN_CODE = ("builtins", "collections", "functools", "jaxtwin", *LIBRARIES)


@runtime_checkable
class Fingerprinted(Protocol):
    """An object that computes its fingerprint itself."""

    @property
    def fingerprint(self) -> str:
        """A text that is equal for equal objects, in every process."""
        ...


class NoFingerprintError(Exception):
    """A value contains something that has no meaning outside of this process, such as a closure."""


def fingerprint(value: object) -> str:
    """A digest of a value. Equal values have the same digest in every process.

    Dataclasses (and therefore `equinox.Module`s) are identified by their fields, functions by their
    names, arrays by shape, type and contents, containers by their entries, and other objects by
    their method `fingerprint`.

    **Raises:** `NoFingerprintError` for closures, lambdas, functions and classes of packages other
    than `KNOWN_CODE`, and objects of any other type.
    """
    digest = hashlib.sha256()
    _add(value, digest.update)
    return digest.hexdigest()


@functools.cache
def surroundings(client: Any) -> str:
    """A digest of everything on which compiled code depends beside its arguments: this package's
    code, the libraries, the interpreter, the processor or accelerator, and XLA's flags."""
    root = Path(__file__).parent.parent
    code = [(str(file.relative_to(root)), file.read_bytes()) for file in sorted(root.rglob("*.py"))]
    versions = [metadata.version(library) for library in LIBRARIES]
    kinds = [device.device_kind for device in client.devices()]
    machine = (platform.machine(), processor(), client.platform_version, kinds)
    return fingerprint(
        (code, versions, tuple(sys.version_info), machine, os.environ.get("XLA_FLAGS"))
    )


def processor() -> str:
    """The processor's instruction sets, as far as the system names them: compilers make code for
    the ones that they find."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")


def _add(value: object, update: Callable[[bytes], None]) -> None:
    update(f"({_name(type(value))}:".encode())
    if isinstance(value, PLAIN):
        update(repr(value).encode())
    elif isinstance(value, type | FunctionType | BuiltinFunctionType):
        update(_name(value).encode())
    elif eqx.is_array(value):
        array = np.asarray(value)
        update(f"{array.shape} {array.dtype}".encode())
        update(array.tobytes())
    else:
        for part in _parts(value):
            _add(part, update)
    update(b")")


def _name(code: type | FunctionType | BuiltinFunctionType) -> str:
    within_function = "<" in code.__qualname__  # also true for a lambda
    if within_function or code.__module__.partition(".")[0] not in KNOWN_CODE:
        raise NoFingerprintError(repr(code))
    return f"{code.__module__}.{code.__qualname__}"


def _parts(value: object) -> list[object]:
    match value:
        case tuple() | list():
            return list(value)
        case Mapping():
            return [part for item in value.items() for part in item]
        case set() | frozenset():
            return sorted(value, key=repr)
        case functools.partial():
            return [value.func, value.args, value.keywords]
        case _ if is_dataclass(value):
            return [part for f in fields(value) for part in (f.name, getattr(value, f.name))]
        case Fingerprinted():
            return [value.fingerprint]
        case _:
            raise NoFingerprintError(repr(value))

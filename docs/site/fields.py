"""Signatures of classes whose fields are their arguments, for mkdocstrings.

griffe knows dataclasses by their decorator. A module of equinox (or a solver of optimistix or
diffrax, which is one) and a named tuple have none.
"""

from collections.abc import Iterator
from typing import Any, final

import griffe

_MODULES = {"equinox", "optimistix", "diffrax"}


@final
class FieldsAsArguments(griffe.Extension):
    """Gives such classes their `__init__`."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Called once the package was read."""
        for part in _classes(pkg):
            if "__init__" in part.members or part.name.startswith("Abstract"):
                continue
            if any(_is_of_fields(base) for base in (part, *part.mro())):
                itself = griffe.Parameter("self", kind=griffe.ParameterKind.positional_or_keyword)
                parameters = griffe.Parameters(itself, *_parameters(part))
                init = griffe.Function("__init__", parent=part, parameters=parameters)
                part.set_member("__init__", init)


def _classes(part: griffe.Module | griffe.Class) -> Iterator[griffe.Class]:
    for member in part.members.values():
        if isinstance(member, griffe.Class):
            yield member
        if isinstance(member, griffe.Module | griffe.Class):
            yield from _classes(member)


def _is_of_fields(part: griffe.Class) -> bool:
    paths = [base.canonical_path for base in part.bases if isinstance(base, griffe.Expr)]
    return any(path == "typing.NamedTuple" or path.split(".")[0] in _MODULES for path in paths)


def _parameters(part: griffe.Class) -> Iterator[griffe.Parameter]:
    fields = {
        name: member
        for base in (*reversed(part.mro()), part)
        for name, member in base.members.items()
        if isinstance(member, griffe.Attribute) and _is_field(member)
    }
    for name, field in fields.items():
        yield griffe.Parameter(
            name,
            annotation=field.annotation,
            kind=griffe.ParameterKind.positional_or_keyword,
            default=_default(field.value),
        )


def _default(value: griffe.Expr | str | None) -> griffe.Expr | str | None:
    """The default that is assigned to a field, or given to `field(default=...)`."""
    if not isinstance(value, griffe.ExprCall) or not value.canonical_path.endswith("field"):
        return value
    named = [argument for argument in value.arguments if isinstance(argument, griffe.ExprKeyword)]
    return next((argument.value for argument in named if argument.name == "default"), None)


def _is_field(attribute: griffe.Attribute) -> bool:
    annotation = str(attribute.annotation or "")
    is_abstract = "AbstractVar" in annotation
    return bool(annotation) and not is_abstract and "property" not in attribute.labels

"""The reference of the Python interface: every public name, from its docstring.

The public names are those that jaxtwin and its packages list in `__all__`. A name of jaxtwin itself
is documented where its package lists it, and in jaxtwin's page where none does.
"""

import functools
import importlib
import inspect
import pkgutil
import re
from pathlib import Path
from typing import Any

import griffe

import jaxtwin

from .links import anchors

# The command line has its own page.
_NO_INTERFACE = {"commands"}
_PAGE = re.compile(r"<code>docs/([a-z-]+)\.md</code>")


def packages() -> list[str]:
    """jaxtwin and its public packages."""
    inner = [
        module.name
        for module in pkgutil.iter_modules(jaxtwin.__path__)
        if module.ispkg and not module.name.startswith("_") and module.name not in _NO_INTERFACE
    ]
    return ["jaxtwin", *(f"jaxtwin.{name}" for name in inner)]


def public_names(package: str) -> list[str]:
    """What a package offers, in alphabetical order."""
    return sorted(importlib.import_module(package).__all__, key=lambda name: (name.lower(), name))


def docstring(package: str, name: str) -> str:
    """Of a public name; also of a constant, which has it in the source alone."""
    found = _source()[f"{package}.{name}".removeprefix("jaxtwin.")]
    found = found.final_target if found.is_alias else found
    return inspect.cleandoc(found.docstring.value) if found.docstring else ""


def summary(text: str) -> str:
    """The first sentences of a docstring, as a cell of a table."""
    return " ".join(text.partition("\n\n")[0].split()).replace("|", "\\|")


def write(folder: Path) -> list[str]:
    """Writes a page for each package.

    **Returns:** the pages, by their names in the folder.
    """
    pages = []
    for package in packages():
        page = folder / f"{package}.md"
        page.write_text(_page(package), encoding="utf-8")
        pages.append(page.name)
    return pages


def home(name: str) -> str:
    """The package in which a name of jaxtwin is documented."""
    value = getattr(jaxtwin, name)
    for package in packages()[1:]:
        module = importlib.import_module(package)
        if name in module.__all__ and getattr(module, name) is value:
            return package
    return "jaxtwin"


def _page(package: str) -> str:
    names = public_names(package)
    homes = {name: home(name) if package == "jaxtwin" else package for name in names}
    about = (importlib.import_module(package).__doc__ or "").partition("\n\n")[0]
    lines = [f"# `{package}`", "", " ".join(about.split()), "", "| name | |", "|---|---|"]
    for name in names:
        there = homes[name]
        link = f"{there}.md#{there}.{name}" if there != package else f"#{package}.{name}"
        # Whoever looks up `jaxtwin.match` finds it here.
        anchor = "" if there == package else f'<span id="{package}.{name}"></span>'
        lines.append(f"| {anchor}[`{name}`]({link}) | {summary(docstring(package, name))} |")
    for name in names:
        if homes[name] == package:
            lines += ["", f"::: {package}.{name}"]
    return "\n".join(lines) + "\n"


def with_links(page: str) -> str:
    """A page's HTML with a link where a docstring names a page of docs/."""
    return _PAGE.sub(r'<a href="../\1.html">\g<0></a>', page)


def missing(reference: Path) -> list[str]:
    """Public names that have no docstring, or that the built pages lack, and methods and properties
    that have none, of their own or inherited; a line each."""
    found = {package: anchors(reference / f"{package}.html") for package in packages()}
    problems = []
    for package in packages():
        for name in public_names(package):
            whole = f"{package}.{name}"
            if whole not in found[package]:
                problems.append(f"reference/{package}.html: {whole} is missing")
            if not docstring(package, name):
                problems.append(f"{whole}: expected a docstring, got none")
    return problems + _undocumented_members()


def _undocumented_members() -> list[str]:
    """Members of public classes without a docstring, a line each."""
    problems = []
    for package in packages():
        for name in public_names(package):
            value = getattr(importlib.import_module(package), name)
            if not inspect.isclass(value) or (package == "jaxtwin" and home(name) != package):
                continue
            problems += [
                f"{package}.{name}.{member}: expected a docstring, got none"
                for member in _members(value)
                if not inspect.getdoc(getattr(value, member))
            ]
    return problems


def _members(owner: type) -> list[str]:
    """The public methods and properties of a class that jaxtwin defines, also in a base of it."""
    return [
        member.name
        for member in inspect.classify_class_attrs(owner)
        if not member.name.startswith("_")
        and member.defining_class.__module__.startswith("jaxtwin.")
        and (member.kind != "data" or isinstance(member.object, functools.cached_property))
    ]


@functools.cache
def _source() -> Any:
    """The package as it is written."""
    return griffe.load("jaxtwin", search_paths=[Path(jaxtwin.__file__).parents[1]])

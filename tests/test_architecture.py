"""Imports between packages go one way, in the order that docs/architecture.md declares."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

import jaxtwin
from jaxtwin._faces import FOR_PACKAGES

SOURCE = Path(jaxtwin.__file__).parent
PAGE = Path(__file__).parents[1] / "docs" / "architecture.md"

# `errors` and the modules `_*.py` beside the packages, on which every package may stand.
FOUNDATION = "the private modules"

# `__init__`, `__main__` and `cli`, which import from any package and are imported by none.
TOP = "the entry points"

# `Twin.simulate` calls `simulate` with a recording: a person at a prompt need import neither.
CONVENIENCES = {("physics/_twin.py", "simulation"), ("physics/_twin.py", "io")}


class Import(NamedTuple):
    """One import between two rooms, a room being a package, `FOUNDATION` or `TOP`."""

    file: str
    source: str
    target: str


def declared_rooms() -> dict[str, list[str]]:
    """The rooms and their packages from the lowest to the highest, as the page lists them."""
    block = re.search(r"```layers\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert block is not None, "docs/architecture.md has no block ```layers"
    rooms: dict[str, list[str]] = {}
    for line in block[1].splitlines():
        name = line.split()[0]
        if line.startswith("  "):
            rooms[list(rooms)[-1]].append(name.rstrip("/"))
        else:
            rooms[name.rstrip(":")] = []
    return rooms


def declared_order() -> list[str]:
    """The packages from the lowest to the highest."""
    return [package for packages in declared_rooms().values() for package in packages]


def room(parts: tuple[str, ...]) -> str:
    """The room of a module, given by its path inside of jaxtwin."""
    if not parts or parts[0] in ("__init__", "__main__", "cli"):
        return TOP
    return FOUNDATION if parts[0].startswith("_") or parts[0] == "errors" else parts[0]


@cache
def imports() -> tuple[Import, ...]:
    """Every import between two rooms, also those inside of functions and under TYPE_CHECKING."""
    return tuple(_imports())


def _imports() -> Iterator[Import]:
    for file in sorted([*SOURCE.rglob("*.py"), *SOURCE.rglob("*.pyi")]):
        parts = file.relative_to(SOURCE).with_suffix("").parts
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            for target in targets(node, parts[:-1]):
                if room(target) != room(parts):
                    name = "/".join(file.relative_to(SOURCE).parts)
                    yield Import(name, room(parts), room(target))


def targets(node: ast.AST, package: tuple[str, ...]) -> list[tuple[str, ...]]:
    """The modules of jaxtwin that a statement imports, as paths inside of jaxtwin."""
    if isinstance(node, ast.Import):
        names = [alias.name.split(".") for alias in node.names]
        return [tuple(name[1:]) for name in names if name[0] == "jaxtwin"]
    if not isinstance(node, ast.ImportFrom):
        return []
    module = tuple(node.module.split(".")) if node.module else ()
    if node.level:
        base = package[: len(package) - node.level + 1]
    elif module[:1] == ("jaxtwin",):
        base, module = (), module[1:]
    else:
        return []
    if base or module:
        return [base + module]
    # `from .. import sweep` takes a name from the face, `from .. import plots` a package.
    rooms = {path.name for path in SOURCE.iterdir() if path.is_dir()}
    names = [alias.name for alias in node.names if alias.name != "__version__"]
    return [(name,) if name in rooms else () for name in names]


def test_every_package_has_its_place_in_the_order():
    packages = {path.parent.name for path in SOURCE.glob("[!_]*/__init__.py")}
    assert sorted(packages) == sorted(declared_order())


@pytest.mark.slow
@pytest.mark.parametrize("package", declared_order())
def test_a_package_imports_only_what_stands_before_it(package: str):
    """Hence there is no circle between packages.

    Commands and the report may take public functions from the face of jaxtwin, as a user does.
    """
    order = declared_order()
    allowed = {FOUNDATION, *order[: order.index(package)]}
    if package in ("report", "commands"):
        allowed.add(TOP)
    found = [entry for entry in imports() if entry.source == package]
    wrong = [
        entry
        for entry in found
        if entry.target not in allowed and (entry.file, entry.target) not in CONVENIENCES
    ]
    assert not wrong


def room_of() -> dict[str, str]:
    """The room of each package."""
    return {package: room for room, packages in declared_rooms().items() for package in packages}


def is_private(target: tuple[str, ...], names: list[str]) -> bool:
    """Whether an import is one of a private module of a package, or of a private name."""
    return any(part.startswith("_") for part in (*target[1:], *names))


def test_there_are_nine_rooms_beside_what_is_shown_and_typed():
    assert len(set(declared_rooms()) - {"show", "commands"}) == 9


@pytest.mark.parametrize("folder", [SOURCE, Path(__file__).parent], ids=["source", "tests"])
def test_another_room_is_entered_by_the_faces_of_its_packages(folder: Path):
    """Modules that tests of several rooms share stand beside the rooms of the tests."""
    rooms = room_of()
    wrong = [
        f"{file.relative_to(folder)}:{node.lineno}"
        for package in rooms
        for file in sorted((folder / package).rglob("*.py"))
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
        for target in targets(node, file.relative_to(folder).parts[:-1])
        if target
        and target[0] in rooms
        and rooms[target[0]] != rooms[package]
        and is_private(target, [alias.name for alias in node.names])
    ]
    assert not wrong


# The rooms of a package, from the lowest to the highest; modules beside them stand above all.
ROOMS = {
    "live": ("protocol", "recording", "conformance", "safety", "virtual_rig"),
    "control": ("linear", "controllers", "loops", "tuning"),
}


@pytest.mark.parametrize(
    ("package", "room"), [(package, room) for package, rooms in ROOMS.items() for room in rooms]
)
def test_a_room_imports_only_what_stands_before_it(package: str, room: str):
    allowed = ROOMS[package][: ROOMS[package].index(room) + 1]
    for file in sorted((SOURCE / package / room).glob("*.py")):
        parts = file.relative_to(SOURCE).parts[:-1]
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            for target in targets(node, parts):
                if target[:1] == (package,):
                    assert target[1] in allowed, f"{file.name} imports {'/'.join(target)}"


@pytest.mark.parametrize("package", ROOMS)
def test_the_rooms_of_a_package_are_those_of_its_page(package: str):
    found = {path.parent.name for path in (SOURCE / package).glob("*/__init__.py")}
    assert found == set(ROOMS[package])
    for room in ROOMS[package]:
        assert f"`{room}/`" in page(package)


@pytest.mark.parametrize("package", [*declared_order(), "_compilation"])
def test_the_page_of_a_package_names_files_that_exist(package: str):
    named = set(re.findall(r"`(_[a-z0-9_]+)`", page(package)))
    stems = {path.stem for path in (SOURCE / package).rglob("*.py")}
    assert named <= stems, sorted(named - stems)


def test_the_page_of_the_architecture_names_files_that_exist():
    named = re.findall(r"`([a-z_/]+\.(?:py|js|c))`", PAGE.read_text(encoding="utf-8"))
    folders = (SOURCE, PAGE.parent, Path(__file__).parent)
    files = [file.as_posix() for folder in folders for file in folder.rglob("*.*")]
    assert len(named) > 30
    assert not [name for name in named if not any(file.endswith(f"/{name}") for file in files)]


def page(package: str) -> str:
    """The docstring of a package, which leads through it."""
    text = (SOURCE / package / "__init__.py").read_text(encoding="utf-8")
    return ast.get_docstring(ast.parse(text)) or ""


def test_the_private_modules_import_no_package():
    assert not [found for found in imports() if found.source == FOUNDATION]


def test_a_face_offers_other_rooms_only_what_they_import():
    rooms = room_of()
    imported = {
        (target[0], alias.name)
        for file in SOURCE.rglob("*.py")
        for parts in [file.relative_to(SOURCE).parts]
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
        for target in targets(node, parts[:-1])
        if target and rooms.get(target[0]) not in (None, rooms.get(parts[0]))
        for alias in node.names
    }
    for package in rooms:
        stub = SOURCE / package / "__init__.pyi"
        if stub.exists():
            _, _, offered = stub.read_text(encoding="utf-8").partition(FOR_PACKAGES)
            for node in ast.parse(offered).body:
                if isinstance(node, ast.ImportFrom):
                    for alias in node.names:
                        assert (package, alias.name) in imported, f"{package}: {alias.name}"

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
    """One import of something of jaxtwin.

    - `file`: below the folder that was read. `line`: in it.
    - `target`: the module, as a path inside of jaxtwin. `names`: what is taken from it.
    """

    file: Path
    line: int
    target: tuple[str, ...]
    names: tuple[str, ...]

    @property
    def source_package(self) -> str:
        return package_of(self.file.with_suffix("").parts)

    @property
    def target_package(self) -> str:
        return package_of(self.target)

    @property
    def is_private(self) -> bool:
        """Whether a module of a package or a name is taken that begins with an underscore."""
        return any(part.startswith("_") for part in (*self.target[1:], *self.names))


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


def package_of(parts: tuple[str, ...]) -> str:
    """The package of a module, given by its path inside of jaxtwin; or `FOUNDATION`, or `TOP`."""
    if not parts or parts[0] in ("__init__", "__main__", "cli"):
        return TOP
    return FOUNDATION if parts[0].startswith("_") or parts[0] == "errors" else parts[0]


@cache
def imports(folder: Path = SOURCE) -> tuple[Import, ...]:
    """Every import of something of jaxtwin, also those inside of functions and under
    TYPE_CHECKING."""
    return tuple(_imports(folder))


def _imports(folder: Path) -> Iterator[Import]:
    for path in sorted([*folder.rglob("*.py"), *folder.rglob("*.pyi")]):
        file = path.relative_to(folder)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for target in targets(node, file.parts[:-1]):
                taken = node.names if isinstance(node, ast.ImportFrom) else []
                names = tuple(alias.name for alias in taken)
                yield Import(file, getattr(node, "lineno", 0), target, names)


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
    wrong = [
        entry
        for entry in imports()
        if entry.source_package == package
        and entry.target_package not in {package, *allowed}
        and (entry.file.as_posix(), entry.target_package) not in CONVENIENCES
    ]
    assert not wrong


def room_of() -> dict[str, str]:
    """The room of each package."""
    return {package: room for room, packages in declared_rooms().items() for package in packages}


def test_there_are_nine_rooms_beside_what_is_shown_and_typed():
    assert len(set(declared_rooms()) - {"show", "commands"}) == 9


@pytest.mark.parametrize("folder", [SOURCE, Path(__file__).parent], ids=["source", "tests"])
def test_another_room_is_entered_by_the_faces_of_its_packages(folder: Path):
    """Modules that tests of several rooms share stand beside the rooms of the tests."""
    rooms = room_of()
    wrong = [
        f"{entry.file}:{entry.line}"
        for entry in imports(folder)
        if entry.is_private
        and entry.target_package in rooms
        and entry.file.parts[0] in rooms
        and rooms[entry.target_package] != rooms[entry.file.parts[0]]
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
    for entry in imports():
        if entry.file.parts[:2] == (package, room) and entry.target[:1] == (package,):
            assert entry.target[1] in allowed, f"{entry.file} imports {'/'.join(entry.target)}"


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
    assert not [
        entry for entry in imports() if entry.source_package == FOUNDATION != entry.target_package
    ]


def test_a_face_offers_other_rooms_only_what_they_import():
    rooms = room_of()
    imported = {
        (entry.target_package, name)
        for entry in imports()
        if entry.file.suffix == ".py"
        and rooms.get(entry.target_package) not in (None, rooms.get(entry.source_package))
        for name in entry.names
    }
    for package in rooms:
        stub = SOURCE / package / "__init__.pyi"
        if stub.exists():
            _, _, offered = stub.read_text(encoding="utf-8").partition(FOR_PACKAGES)
            for node in ast.parse(offered).body:
                if isinstance(node, ast.ImportFrom):
                    for alias in node.names:
                        assert (package, alias.name) in imported, f"{package}: {alias.name}"

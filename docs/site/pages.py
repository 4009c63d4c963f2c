"""The project's Markdown as pages of the site.

A page has the same links in the repository and on the site. What they point to may have another
place there: `place` says which. A file that is no page, such as a module of the package, becomes a
page that shows it as soon as a link leads to it, and a folder becomes a list of its files.
"""

import posixpath
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import final
from urllib.parse import urlparse

from .notebook import to_markdown

ROOTS = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
}
"""Pages that stand beside docs/ in the repository."""

FOLDERS = ("docs/", "docs/firmware/", "benchmarks/", "benchmarks/results/", "notebooks/")
"""Whose Markdown and notebooks are pages."""

MOST_SHOWN = 12
"""Files of a folder that become pages because a link leads to the folder."""

LANGUAGES = {
    ".cff": "yaml",
    ".h": "c",
    ".ino": "cpp",
    ".json": "json",
    ".py": "python",
    ".pyi": "python",
    ".service": "ini",
    ".toml": "toml",
    ".yaml": "yaml",
}
PICTURES = {".png", ".svg", ".gif"}

# Code, in which there are no links; and what a link points to.
_CODE = re.compile(r"^(`{3,}|~{3,}).*?^\1 *$|`[^`\n]+`", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(?<=\]\()([^()\s]+)(?=\))")


@final
class Pages:
    """Puts the pages of a checkout into a folder.

    **Arguments:**

    - `checkout`: the root of the repository.
    - `folder`: where the pages go.
    """

    def __init__(self, checkout: Path, folder: Path):
        self._checkout, self._folder = checkout, folder
        listed = subprocess.run(
            ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
            cwd=checkout,
            capture_output=True,
            text=True,
            check=True,
        )
        self._files = {name for name in listed.stdout.splitlines() if (checkout / name).is_file()}
        self._waiting: list[str] = []

    def write(self) -> None:
        """Writes all pages, and what they link to."""
        written: set[str] = set()
        self._waiting = sorted(name for name in self._files if _is_page(name))
        while self._waiting:
            name = self._waiting.pop()
            if name not in written:
                written.add(name)
                self._write(name)

    def _write(self, name: str) -> None:
        source, target = self._checkout / name, self._folder / place(name)
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            text = self._listing(name)
        elif source.suffix in PICTURES:
            target.write_bytes(source.read_bytes())
            return
        elif source.suffix == ".ipynb":
            text = to_markdown(source, target)
        elif _is_page(name):
            text = _indented_by_four(source.read_text(encoding="utf-8"))
        else:
            target.write_text(_shown(name, source.read_text(encoding="utf-8")), encoding="utf-8")
            return
        target.write_text(self._moved(text, name), encoding="utf-8")

    def _moved(self, text: str, name: str) -> str:
        """A page's text with links that lead to the same from its place on the site."""
        base = name if (self._checkout / name).is_dir() else posixpath.dirname(name)

        def target(link: re.Match[str]) -> str:
            path, hash_, anchor = link[1].partition("#")
            if not path or urlparse(path).scheme:
                return link[1]
            beside = posixpath.normpath(posixpath.join(base, path))
            if beside not in self._files and not self._under(beside):
                raise FileNotFoundError(f"{name}: expected a file of the repository, got {link[1]}")
            self._waiting.append(beside)
            here = posixpath.relpath(place(beside), posixpath.dirname(place(name)) or ".")
            return here + hash_ + anchor

        return "".join(
            part if is_code else _LINK.sub(target, part) for is_code, part in _code_apart(text)
        )

    def _under(self, folder: str) -> list[str]:
        return sorted(name for name in self._files if name.startswith(folder + "/"))

    def _listing(self, folder: str) -> str:
        """What is in a folder: its folders as names, and its files, which are links where they are
        few."""
        inside = [PurePosixPath(name).relative_to(folder).parts for name in self._under(folder)]
        files = [parts[0] for parts in inside if len(parts) == 1]
        folders = dict.fromkeys(parts[0] for parts in inside if len(parts) > 1)
        lines = [_front(f"{folder}/"), f"# `{folder}/`", ""]
        lines += [f"- `{name}/`" for name in folders]
        few = len(files) <= MOST_SHOWN
        lines += [f"- [`{name}`]({name})" if few else f"- `{name}`" for name in files]
        return "\n".join(lines) + "\n"


def place(name: str) -> str:
    """Where a file or a folder of the repository is among the pages."""
    if name in ROOTS:
        return ROOTS[name]
    path = PurePosixPath(name)
    if _is_page(name) or path.suffix in PICTURES:
        return str(path.with_suffix(".md") if path.suffix == ".ipynb" else path).removeprefix(
            "docs/"
        )
    # A folder's list must not be the index of the folder: it would be a section of its own.
    return f"source/{name}.md"


def _is_page(name: str) -> bool:
    folder, _, file = name.rpartition("/")
    return name in ROOTS or (f"{folder}/" in FOLDERS and file.endswith((".md", ".ipynb")))


def _shown(name: str, text: str) -> str:
    """A page that shows a file."""
    language = LANGUAGES.get(PurePosixPath(name).suffix, "text")
    return f"{_front(name)}\n# `{name}`\n\n~~~~~{language}\n{text.rstrip()}\n~~~~~\n"


def _front(title: str) -> str:
    return f'---\ntitle: "{title}"\nsearch:\n  exclude: true\nhide:\n  - toc\n---\n'


def _indented_by_four(text: str) -> str:
    """What continues a list's item is indented by three columns in the repository, by four here."""
    lines, fenced = [], False
    for line in text.splitlines():
        fenced ^= line.startswith("```")
        lines.append(" " + line if line.startswith("   ") and not fenced else line)
    return "\n".join(lines) + "\n"


def _code_apart(text: str) -> Iterator[tuple[bool, str]]:
    """The parts of a text, each with whether it is code."""
    end = 0
    for code in _CODE.finditer(text):
        yield False, text[end : code.start()]
        yield True, code[0]
        end = code.end()
    yield False, text[end:]

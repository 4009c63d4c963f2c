"""What a release consists of agrees: version and requirements are the same in every file."""

import re
import tomllib
from pathlib import Path

import jaxtwin

CHECKOUT = Path(__file__).parents[1]
RECIPE = (CHECKOUT / "conda" / "recipe.yaml").read_text(encoding="utf-8")
PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

# The name on conda-forge where it is another; `matplotlib` there brings a screen's libraries.
CONDA_NAMES = {"matplotlib": "matplotlib-base"}


def section(name: str) -> list[str]:
    """The entries of a list of the recipe's requirements."""
    found = re.search(rf"^  {name}:\n((?:    - .*\n)+)", RECIPE, re.MULTILINE)
    assert found is not None
    return [line.removeprefix("    - ") for line in found[1].splitlines()]


def conda(requirement: str) -> str:
    name, bound = re.split(r"(?=>=)", requirement)
    return f"{CONDA_NAMES.get(name, name)} {bound}"


def test_the_newest_release_of_the_changelog_is_the_version():
    headings = re.findall(r"^## (.+)$", (CHECKOUT / "CHANGELOG.md").read_text("utf-8"), re.M)
    assert headings[0] == "Unreleased"
    assert headings[1].split()[0] == jaxtwin.__version__


def test_citation_and_recipe_have_the_version():
    citation = (CHECKOUT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {jaxtwin.__version__}\n" in citation
    assert f'\n  version: "{jaxtwin.__version__}"\n' in RECIPE


def test_the_conda_recipe_needs_what_the_wheel_needs():
    python = PROJECT["requires-python"].removeprefix(">=")
    assert f'\n  python_min: "{python}"\n' in RECIPE
    needed = [conda(requirement) for requirement in PROJECT["dependencies"]]
    assert section("run") == ["python >=${{ python_min }}", *needed]


def test_the_conda_recipe_builds_with_what_the_wheel_builds_with():
    text = (CHECKOUT / "pyproject.toml").read_text(encoding="utf-8")
    builds = tomllib.loads(text)["build-system"]["requires"]
    assert section("host")[2:] == [conda(requirement) for requirement in builds]


def test_the_conda_recipe_installs_the_command():
    (command,) = PROJECT["scripts"].items()
    assert f"      - {' = '.join(command)}\n" in RECIPE

"""The documentation site: `make docs` writes build/site/index.html.

The site needs no network: no font, script or style comes from elsewhere, and equations are MathML.
"""

import shutil
import subprocess
import sys
from pathlib import Path

from . import command_line, links, mathml, pictures, python, rig_file, typography
from .pages import Pages

CHECKOUT = Path(__file__).parents[2]
HERE, BUILD = Path(__file__).parent, CHECKOUT / "build"


def main() -> None:
    """Builds the site and checks it."""
    pages, site = BUILD / "pages", BUILD / "site"
    for folder in (pages, site, BUILD / ".cache"):
        shutil.rmtree(folder, ignore_errors=True)
    reference = pages / "reference"
    reference.mkdir(parents=True)
    Pages(CHECKOUT, pages).write()
    for name in ("style.css", "accessible.js"):
        shutil.copy(HERE / name, pages)
    mathml.copy_font(pages)
    command_line.write(reference / "command-line.md")
    rig_file.write(reference / "rig-file.md")
    modules = [f'"reference/{page}"' for page in python.write(reference)]
    settings = (HERE / "zensical.toml").read_text(encoding="utf-8")
    settings = settings.replace('"PYTHON"', f"[{', '.join(modules)}]")
    (BUILD / "zensical.toml").write_text(settings, encoding="utf-8")
    _zensical()
    for page in site.rglob("*.html"):
        content = pictures.scrolling(page.read_text(encoding="utf-8"), page.parent)
        content = mathml.rendered(content)
        content = content.replace("<th></th>", "<td></td>")  # a head without a name is none
        if page.parent == site / "reference":
            content = python.with_links(content)
        content = typography.set_breaks(content)
        page.write_text(content, encoding="utf-8")
    problems = links.problems(site) + python.missing(site / "reference")
    if problems:
        sys.exit("\n".join([f"build/site: {len(problems)} problems", *problems]))
    print(f"{site / 'index.html'}: {sum(1 for _ in site.rglob('*.html'))} pages")


def _zensical() -> None:
    """Markdown -> HTML; a warning is an error."""
    command = [sys.executable, "-m", "zensical", "build", "--strict"]
    run = subprocess.run(command, cwd=BUILD, capture_output=True, text=True)
    said = run.stdout + run.stderr
    if run.returncode or "warning" in said.lower():
        sys.exit(said)


if __name__ == "__main__":
    main()

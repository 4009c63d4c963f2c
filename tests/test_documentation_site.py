"""The documentation site: what its own parts do with links, notebooks and commands.

`make docs` builds the whole and checks it.
"""

import base64
import json
import re
import struct
import subprocess
from pathlib import Path

import pandas
import pytest

from docs.site import command_line, links, pictures
from docs.site.notebook import to_markdown
from docs.site.pages import Pages, place
from docs.site.typography import set_breaks

EQUATION = '<span class="equation-inline"><math display="inline"><mi>y</mi></math></span>'


def written(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def test_a_site_whose_links_lead_somewhere_has_no_problems(tmp_path: Path) -> None:
    site = written(
        tmp_path,
        {
            "index.html": '<a href="a.html#part">a</a> <a href="https://jax.dev">elsewhere</a>',
            "a.html": '<h2 id="part">part</h2> <a href="#part">up</a> <a href=".">home</a>',
            "b/index.html": '<script src="../x.js"></script> <a href="../a.html">a</a>',
            "x.js": "",
        },
    )
    assert links.problems(site) == []


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('<a href="b.html">b</a>', "index.html: b.html leads to no file"),
        ('<a href="#part">part</a>', "index.html: #part leads to no anchor"),
        ('<img src="b.png">', "index.html: b.png leads to no file"),
        (
            '<script src="https://cdn.example/x.js"></script>',
            "index.html: loads https://cdn.example/x.js from a network",
        ),
        (
            '<link rel="stylesheet" href="//fonts.example/a.css">',
            "index.html: loads //fonts.example/a.css from a network",
        ),
    ],
)
def test_a_link_that_leads_nowhere_and_what_needs_a_network_are_problems(
    tmp_path: Path, text: str, problem: str
) -> None:
    assert links.problems(written(tmp_path, {"index.html": text})) == [problem]


def test_a_style_that_loads_from_a_network_is_a_problem(tmp_path: Path) -> None:
    style = '@font-face { src: url("https://fonts.example/a.woff") }'
    assert links.problems(written(tmp_path, {"a.css": style})) == ["a.css: loads from a network"]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository with a page, what it links to, and a link in code that is none."""
    folder = tmp_path / "checkout"
    folder.mkdir()
    subprocess.run(["git", "init", "--quiet"], cwd=folder, check=True)
    readme = "[a](docs/a.md#part) [code](src/code.py) [data](src/data) [web](https://jax.dev)\n"
    return written(
        folder,
        {
            "README.md": readme,
            "docs/a.md": "[up](../README.md) [here](#part) `run[0](loop)`\n\n## Part\n",
            "src/code.py": "x = 1\n",
            "src/data/one.toml": "one = 1\n",
        },
    )


def test_links_lead_to_the_same_from_their_place_on_the_site(
    checkout: Path, tmp_path: Path
) -> None:
    pages = tmp_path / "pages"
    Pages(checkout, pages).write()
    assert (pages / "index.md").read_text() == (
        "[a](a.md#part) [code](source/src/code.py.md) [data](source/src/data.md) "
        "[web](https://jax.dev)\n"
    )
    assert "[up](index.md) [here](#part) `run[0](loop)`" in (pages / "a.md").read_text()
    assert "~~~~~python\nx = 1\n~~~~~" in (pages / "source/src/code.py.md").read_text()
    assert "[`one.toml`](data/one.toml.md)" in (pages / "source/src/data.md").read_text()
    assert (pages / place("src/data/one.toml")).exists()


def test_a_link_to_what_is_not_in_the_repository_is_an_error(
    checkout: Path, tmp_path: Path
) -> None:
    (checkout / "docs/a.md").write_text("[gone](gone.md)")
    with pytest.raises(FileNotFoundError, match=r"docs/a\.md: .* got gone\.md"):
        Pages(checkout, tmp_path / "pages").write()


def test_every_page_of_the_project_is_in_the_navigation() -> None:
    root = Path(__file__).parent.parent
    settings = (root / "docs/site/zensical.toml").read_text()
    files = [*root.glob("docs/*.md"), *root.glob("notebooks/*.ipynb")]
    files += [*root.glob("docs/firmware/*.md"), *root.glob("benchmarks/**/*.md")]
    assert len(files) > 20
    for file in files:
        assert f'"{place(str(file.relative_to(root)))}"' in settings


def test_a_notebook_becomes_a_page_with_its_results(tmp_path: Path) -> None:
    outputs = [
        {"output_type": "stream", "text": ["12\n"]},
        {"data": {"image/png": base64.b64encode(b"picture").decode(), "text/plain": ["<Figure>"]}},
        {"data": {"text/html": ["<table>\n", "\n", "</table>"], "text/plain": ["table"]}},
        {"data": {"image/gif": base64.b64encode(b"film").decode(), "text/plain": ["<Image>"]}},
    ]
    cells = [
        {"cell_type": "markdown", "source": ["# Title\n", "text"]},
        {"cell_type": "code", "source": ["print(12)"], "outputs": outputs},
    ]
    notebook = tmp_path / "a.ipynb"
    notebook.write_text(json.dumps({"cells": cells}))
    page = to_markdown(notebook, tmp_path / "a.md")
    assert page.startswith("# Title\ntext\n\n```python\nprint(12)\n```\n")
    assert "~~~~~{ .text .result }\n12\n~~~~~" in page
    assert '<img src="a-1.png"' in page
    assert "<table>\n</table>" in page
    assert (tmp_path / "a-1.png").read_bytes() == b"picture"
    assert '<img src="a-2.gif"' in page
    assert (tmp_path / "a-2.gif").read_bytes() == b"film"


def test_a_table_of_pandas_gets_one_header_and_the_style_of_the_site(tmp_path: Path) -> None:
    table = pandas.DataFrame({"Kp": [0.2], "energy": [7.5]}, pandas.Index([30], name="weight"))
    cell = {
        "cell_type": "code",
        "source": ["table"],
        "outputs": [{"data": {"text/html": table._repr_html_()}}],  # pyright: ignore[reportCallIssue]
    }
    notebook = tmp_path / "a.ipynb"
    notebook.write_text(json.dumps({"cells": [cell]}))
    page = to_markdown(notebook, tmp_path / "a.md")
    assert '<div class="result numbers">' in page
    assert "dataframe" not in page
    head = page[page.index("<thead>") : page.index("</thead>")]
    assert re.findall("<th>(.*?)</th>", head) == ["weight", "Kp", "energy"]
    assert head.count("<tr") == 1
    assert re.findall("<t[hd]>(.*?)</t", page[page.index("<tbody>") :]) == ["30", "0.2", "7.5"]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("<p>20 s of 10 000 K</p>", "<p>20\xa0s of 10\xa0000\xa0K</p>"),
        ("<td>74.4 %</td>", "<td>74.4\xa0%</td>"),
        ("<td>8.4e-06</td>", '<td><span class="whole">8.4e-06</span></td>'),
        ("<title>8.4e-06</title>", "<title>8.4e-06</title>"),
        ("<td>3 -&gt; 2</td>", '<td>3 <span class="whole">-&gt;</span> 2</td>'),
        ("<p>15 W/(m² K), 5 Kp, in 2024 it</p>", "<p>15 W/(m² K), 5 Kp, in 2024 it</p>"),
        ("<pre><code>20 s</code></pre>", "<pre><code>20 s</code></pre>"),
        ('<td><code class="x">20 s</code></td>', '<td><code class="x">20 s</code></td>'),
        (f"<td><code>{'a' * 33}</code></td>", f'<td><code class="long">{"a" * 33}</code></td>'),
        (f"<td><code>{'a' * 32}</code></td>", f"<td><code>{'a' * 32}</code></td>"),
        (f"<p><code>{'a' * 33}</code></p>", f"<p><code>{'a' * 33}</code></p>"),
        ("<code>--out F</code>", '<code><span class="whole">--out</span> F</code>'),
        ("<td><code>x -Os</code>", '<td><code>x <span class="whole">-Os</span></code>'),
        ("<code>dual-cell</code>", '<code><span class="whole">dual-cell</span></code>'),
        (f"<code>a-{'a' * 23}</code>", f"<code>a-{'a' * 23}</code>"),
        ("<code>a - b, -</code>", "<code>a - b, -</code>"),
        ("<pre><code>dual-cell</code></pre> dual-cell",) * 2,
        ("<p>a TEC1-12706.</p>", '<p>a <span class="whole">TEC1-12706</span>.</p>'),
        ("<p>or --split</p>", '<p>or <span class="whole">--split</span></p>'),
        ("<p>a -&gt; b, 60-69</p>", '<p>a <span class="whole">-&gt;</span> b, 60-69</p>'),
        (f"<p>({EQUATION}), b</p>", f'<p><span class="whole">({EQUATION}),</span> b</p>'),
        (f"<p>{EQUATION} b</p>",) * 2,
    ],
)
def test_lines_do_not_break_within_a_quantity_or_an_option(text: str, found: str) -> None:
    assert set_breaks(text) == found


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("<h2>jaxtwin.control.Controller</h2>", "<h2>jaxtwin.<wbr>control.<wbr>Controller</h2>"),
        (
            "<h3>largest_temperature_difference</h3>",
            "<h3>largest_<wbr>temperature_<wbr>difference</h3>",
        ),
        ("<h3>jaxtwin.rig.Rig</h3>",) * 2,
        (f"<code>jaxtwin.{'a' * 30}</code>", f"<code>jaxtwin.<wbr>{'a' * 30}</code>"),
        (f"<code>a=0.01,{'b' * 30}.py</code>", f"<code>a=0.01,<wbr>{'b' * 30}.py</code>"),
        ("<code>jaxtwin.rig.load_rig</code>",) * 2,
    ],
)
def test_long_names_break_after_a_dot(text: str, found: str) -> None:
    assert set_breaks(text) == found


@pytest.mark.parametrize("width", [599, 600])
def test_pictures_that_are_wider_than_a_phone_scroll(tmp_path: Path, width: int) -> None:
    header = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", width, 9)
    (tmp_path / "a.png").write_bytes(header)
    picture = '<img alt="a" src="a.png" />'
    found = pictures.scrolling(f"<p>{picture}</p>", tmp_path)
    assert found == (
        f'<p><span class="panels" tabindex="0">{picture}</span></p>'
        if width == 600
        else f"<p>{picture}</p>"
    )


def test_the_cells_of_a_column_that_explains_are_marked() -> None:
    head = "<table><thead><tr><th>a</th><th>b</th></tr></thead>"
    rows = ["<tr><td>1</td><td>short</td></tr>", f"<tr><td>2</td><td>{'long ' * 9}</td></tr>"]
    found = set_breaks(head + "".join(rows) + "</table>")
    assert found == head + "".join(rows).replace("<td>short", '<td class="prose">short').replace(
        "<td>long", '<td class="prose">long'
    ) + ("</table>")
    assert set_breaks(f"{head}{rows[0]}</table>") == f"{head}{rows[0]}</table>"


def test_every_command_and_option_is_in_the_reference(tmp_path: Path) -> None:
    page = tmp_path / "command-line.md"
    command_line.write(page)
    sections = dict(re.findall(r"^## `([^`]+)`\n(.*?)(?=^## |\Z)", page.read_text(), re.M | re.S))
    assert {"jaxtwin demo", "jaxtwin match", "jaxtwin data fetch"} <= set(sections)
    assert "**`--out FILE`**" in sections["jaxtwin match"]
    assert "| `--starts" in sections["jaxtwin match"]
    assert "jaxtwin data fetch --to recordings" in sections["jaxtwin data fetch"]
    assert not re.search(r"\[/?(bold|dim)\]", page.read_text())

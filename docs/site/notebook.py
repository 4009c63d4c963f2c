"""A notebook as a page, with the results that it holds."""

import base64
import json
import re
from pathlib import Path
from typing import Any

_PANDAS = '<table border="1" class="dataframe">'
_OWN_STYLE = re.compile(r"<style scoped>.*?</style>", re.DOTALL)
_TWO_HEADERS = re.compile(
    r"<th></th>(?P<columns>(?:\s*<th>[^<]*</th>)*\s*</tr>)\s*<tr>\s*<th>(?P<index>[^<]+)</th>"
    r"(?:\s*<th></th>)*\s*</tr>"
)


def to_markdown(notebook: Path, page: Path) -> str:
    """The cells of a notebook as Markdown.

    **Arguments:**

    - `notebook`: the .ipynb file.
    - `page`: where the Markdown goes; pictures are written beside it.
    """
    content = json.loads(notebook.read_text(encoding="utf-8"))
    parts, pictures = [], 0
    for cell in content["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(text)
            continue
        parts.append(f"```python\n{text}\n```")
        for output in cell.get("outputs", []):
            data: dict[str, Any] = output.get("data", {})
            kind = next((kind for kind in ("png", "gif") if f"image/{kind}" in data), None)
            if kind is not None:
                pictures += 1
                file = page.with_name(f"{page.stem}-{pictures}.{kind}")
                file.write_bytes(base64.b64decode("".join(data[f"image/{kind}"])))
                image = f'<img src="{file.name}" alt="what the code above draws">'
                parts.append(f'<p class="result">{image}</p>')
            elif "text/markdown" in data:
                parts.append("".join(data["text/markdown"]))
            elif "text/html" in data:
                html = "".join(data["text/html"])
                classes = "result numbers" if _PANDAS in html else "result"
                html = _of_pandas(html)
                # An empty line would end the HTML.
                kept = "\n".join(line for line in html.splitlines() if line.strip())
                parts.append(f'<div class="{classes}">\n{kept}\n</div>')
            else:
                plain = "".join(output.get("text", data.get("text/plain", "")))
                if plain.strip():
                    parts.append(f"~~~~~{{ .text .result }}\n{plain.rstrip()}\n~~~~~")
    return "\n\n".join(parts) + "\n"


def _of_pandas(html: str) -> str:
    """A table of pandas as the other tables of the site: without a frame and a style of its own,
    and with the name of its index beside those of the columns, not below them."""
    plain = _OWN_STYLE.sub("", html).replace(_PANDAS, "<table>")
    return _TWO_HEADERS.sub(r"<th>\g<index></th>\g<columns>", plain)

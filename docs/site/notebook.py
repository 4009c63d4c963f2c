"""A notebook as a page, with the results that it holds."""

import base64
import json
from pathlib import Path
from typing import Any


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
                # An empty line would end the HTML.
                kept = "\n".join(line for line in html.splitlines() if line.strip())
                parts.append(f'<div class="result">\n{kept}\n</div>')
            else:
                plain = "".join(output.get("text", data.get("text/plain", "")))
                if plain.strip():
                    parts.append(f"~~~~~{{ .text .result }}\n{plain.rstrip()}\n~~~~~")
    return "\n\n".join(parts) + "\n"

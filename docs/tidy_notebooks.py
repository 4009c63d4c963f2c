"""Makes executed notebooks small, and the same wherever they were executed.

    python docs/tidy_notebooks.py notebooks/*.ipynb

Pictures get a palette of 256 colours, which takes a third of the bytes. Messages on how long
something took, when each cell was executed, the names of temporary folders, and widgets, which show
nothing without a kernel, are left out; what was printed in parts is joined.
"""

import base64
import io
import json
import re
import sys
from pathlib import Path
from typing import Any

from PIL import Image

COLORS = 256
TEMPORARY = re.compile(r"/tmp/tmp\w{8}/")


def with_few_colors(content: bytes) -> bytes:
    """A .png file with a palette, if that is smaller."""
    picture = Image.open(io.BytesIO(content))
    if picture.mode == "P":
        return content
    small = io.BytesIO()
    # The median cut, which is Pillow's default, takes its colours from the large areas, and draws a
    # colour bar in those of other things.
    reduced = picture.convert("RGB").quantize(
        COLORS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
    )
    reduced.save(small, "PNG", optimize=True)
    return min(small.getvalue(), content, key=len)


def tidy(notebook: dict[str, Any]) -> dict[str, Any]:
    """A notebook as it is kept; the same where it is already."""
    notebook.get("metadata", {}).pop("widgets", None)
    for cell in notebook["cells"]:
        cell["metadata"].pop("execution", None)
        if "outputs" not in cell:
            continue
        kept = [each for each in cell["outputs"] if each.get("name") != "stderr"]
        cell["outputs"] = _joined(kept)
        for output in cell["outputs"]:
            data = output.get("data", {})
            data.pop("application/vnd.jupyter.widget-view+json", None)
            if "image/png" in data:
                content = base64.b64decode("".join(data["image/png"]))
                data["image/png"] = base64.b64encode(with_few_colors(content)).decode() + "\n"
            for holder, key in ((output, "text"), (data, "text/html"), (data, "text/plain")):
                if key in holder:
                    holder[key] = [TEMPORARY.sub("", line) for line in _lines(holder[key])]
    return notebook


def _lines(text: str | list[str]) -> list[str]:
    return [text] if isinstance(text, str) else text


def _joined(outputs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The outputs, with what was printed in several parts in one."""
    joined: list[dict[str, Any]] = []
    for output in outputs:
        if joined and output.get("name") == joined[-1].get("name") == "stdout":
            parts = [*joined[-1]["text"], *output["text"]]
            joined[-1] = {**output, "text": "".join(parts).splitlines(keepends=True)}
        else:
            joined.append(output)
    return joined


def main() -> None:
    """Tidies the files that are named."""
    for name in sys.argv[1:]:
        path = Path(name)
        notebook = tidy(json.loads(path.read_text(encoding="utf-8")))
        text = json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

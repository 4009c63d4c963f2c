"""The notebooks as they are kept: executed, small, without what differs between machines.

`make notebook-check` executes them.
"""

import base64
import copy
import io
import json
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from PIL import Image

from docs.tidy_notebooks import tidy, with_few_colors

FOLDER = Path(__file__).parent.parent / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

# Bytes.
LARGEST = 400_000


def test_a_picture_keeps_its_size_and_nearly_its_colours() -> None:
    pixels = np.full((50, 80, 3), 255, np.uint8)
    pixels[10:30, 20:60] = (0, 114, 178)
    shaded = np.linspace(0, 255, 80).astype(np.uint8)
    pixels[40:] = np.stack([shaded, shaded, shaded[::-1]], axis=-1)
    content = io.BytesIO()
    Image.fromarray(pixels).save(content, "PNG")
    small = Image.open(io.BytesIO(with_few_colors(content.getvalue())))
    assert small.size == (80, 50)
    difference = np.asarray(small.convert("RGB")).astype(int) - pixels
    assert np.abs(difference).max() <= 4
    assert with_few_colors(with_few_colors(content.getvalue())) == with_few_colors(
        content.getvalue()
    )


def test_a_small_colour_bar_beside_large_areas_keeps_its_colours() -> None:
    x, y = np.meshgrid(np.linspace(0, 0.7, 600), np.linspace(0, 0.3, 400))
    pixels = matplotlib.colormaps["inferno"](x + y, bytes=True)[..., :3]
    bar = matplotlib.colormaps["RdBu_r"](np.linspace(0, 1, 100), bytes=True)
    pixels[100:200, 580:590] = bar[:, None, :3]
    content = io.BytesIO()
    Image.fromarray(pixels).save(content, "PNG")
    small = Image.open(io.BytesIO(with_few_colors(content.getvalue())))
    difference = np.asarray(small.convert("RGB")).astype(int) - pixels
    assert np.abs(difference).max() <= 12


def test_messages_and_times_of_execution_are_left_out() -> None:
    outputs = [{"name": "stderr", "text": "jaxtwin: 3 s"}, {"name": "stdout", "text": ["fit"]}]
    cell = {"metadata": {"execution": {}, "tags": []}, "outputs": outputs}
    words = {"metadata": {"execution": {}}, "source": "Words"}
    found = tidy({"cells": [cell, words]})["cells"]
    assert found[0] == {"metadata": {"tags": []}, "outputs": outputs[1:]}
    assert found[1]["metadata"] == {}


def test_widgets_are_left_out() -> None:
    view = "application/vnd.jupyter.widget-view+json"
    output = {"data": {view: {"model_id": "1"}, "text/plain": ["Sliders()"]}}
    cell = {"metadata": {}, "outputs": [output]}
    found = tidy({"cells": [cell], "metadata": {"widgets": {}, "language": "python"}})
    assert found["metadata"] == {"language": "python"}
    assert found["cells"][0]["outputs"] == [{"data": {"text/plain": ["Sliders()"]}}]


def test_names_of_temporary_folders_are_left_out() -> None:
    shown = {
        "output_type": "execute_result",
        "data": {"text/html": "<b>/tmp/tmpc0w0t9sc/a.toml</b>"},
    }
    (found,) = tidy({"cells": [{"metadata": {}, "outputs": [shown]}]})["cells"]
    assert found["outputs"][0]["data"] == {"text/html": ["<b>a.toml</b>"]}


def test_what_was_printed_in_parts_is_joined() -> None:
    parts = [{"name": "stdout", "output_type": "stream", "text": [text]} for text in ("a\n", "b\n")]
    picture = {"output_type": "display_data", "data": {}}
    cell = {"metadata": {}, "outputs": [*parts, {"name": "stderr", "text": "s"}, picture, parts[0]]}
    (found,) = tidy({"cells": [cell]})["cells"]
    assert found["outputs"] == [{**parts[0], "text": ["a\n", "b\n"]}, picture, parts[0]]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_executed_and_tidy(path: Path) -> None:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert path.stat().st_size < LARGEST
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all(cell["execution_count"] for cell in cells)
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert not [output for output in outputs if output["output_type"] == "error"]
    pictures = [output["data"]["image/png"] for output in outputs if _is_picture(output)]
    assert pictures
    modes = {Image.open(io.BytesIO(base64.b64decode(picture))).mode for picture in pictures}
    assert modes == {"P"}
    assert tidy(copy.deepcopy(notebook)) == notebook


def _is_picture(output: dict) -> bool:
    return "image/png" in output.get("data", {})


def test_the_index_names_every_notebook() -> None:
    index = (FOLDER / "README.md").read_text(encoding="utf-8")
    for path in NOTEBOOKS:
        assert f"]({path.name})" in index

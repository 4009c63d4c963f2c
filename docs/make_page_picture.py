"""The picture of the page in serve.md, and pages of five rigs to look at.

    python docs/make_page_picture.py [FOLDER [RIG ...]]

Needs Playwright and Chromium (`pip install playwright`, Debian's package `chromium`), and takes
three minutes for each rig: a virtual rig is driven at five times its speed, something fails after
ten minutes of it, and the page is drawn before, when it is found and when it is diagnosed. Without
a folder only the picture of the documentation is drawn; with one all rigs, or those that are named,
at 390, 1280, 1600 and 2560 pixels, light and dark.
"""

import dataclasses
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image
from playwright.sync_api import FloatRect, Page, sync_playwright

import jaxtwin as jt
from jaxtwin.observers import live_observer

SPEED, FAULT_AT = 5, 600
PICTURED = "dual-cell"
"""The rig of the picture in the documentation."""

# Rig -> what fails, the duty, and what its observer takes as uncertain.
RIGS: dict[str, tuple[str, list[float], tuple[str, ...]]] = {
    "single-cell": ("age=P1@{}/2.5", [0.4], ()),
    "dual-cell": ("loosen=P1@{}/4", [0.5, 0.35], ("R_pc1_row1", "R_pc2_row1", "R_sink1")),
    "tclab": ("weaken=H1@{}/0.6", [0.7, 0.4], ("R_1", "R_2")),
    "heated-box": ("leak=air@{}/20", [0.2], ()),
    "foil": ("age=foil@{}/1.8", [0.2, 0.5], ()),
}
WIDTHS = (390, 1280, 1600, 2560)
WAIT_MS = 300_000
"""The longest time until the fault is diagnosed, ms."""

PICTURE = Path(__file__).parent / "images" / "serve.png"
DRIVE = """([token, duty]) => fetch('/control/drive', {method: 'POST',
    headers: {'content-type': 'application/json', authorization: `Bearer ${token}`},
    body: JSON.stringify({duty, seconds: 7200})}).then((answer) => answer.text())"""


def main() -> None:
    """Serves, waits and draws."""
    into = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    rigs = sys.argv[2:] or (RIGS if into else [PICTURED])
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(
            executable_path="/usr/bin/chromium", args=["--no-sandbox"]
        )
        for rig in rigs:
            page = browser.new_page(viewport={"width": 1600, "height": 900})
            server = served(rig, Path(folder))
            try:
                assert server.stdout is not None
                text = next(line for line in server.stdout if "#" in line)
                address, token = re.findall(r"(http://[^\s#]+)#(\S+)", text)[0]
                page.goto(address)
                print(rig, page.evaluate(DRIVE, [token, RIGS[rig][1]]))
                if into is not None:
                    time.sleep((FAULT_AT - 60) / SPEED)
                    draw_all(page, into, f"{rig}-before")
                    page.wait_for_selector(".answer.warning", timeout=WAIT_MS)
                    draw_all(page, into, f"{rig}-during")
                page.wait_for_selector(".cause", timeout=WAIT_MS)
                page.wait_for_timeout(1500)
                if into is not None:
                    draw_all(page, into, f"{rig}-after")
                else:
                    parameters = page.locator(".parameters").bounding_box()
                    assert parameters is not None
                    height = round(parameters["y"] + parameters["height"] + 12)
                    draw(page, PICTURE, {"x": 0, "y": 0, "width": 1600, "height": height})
            finally:
                server.terminate()
                server.wait()
                page.close()
        browser.close()


def served(rig: str, folder: Path) -> subprocess.Popen[str]:
    """A server of the page of a virtual rig."""
    fault, _, uncertain = RIGS[rig]
    if rig == "foil":
        rig = str(foil_plate(folder))
    noise = folder / "noise.toml"
    usual = live_observer(jt.Twin(jt.load_rig(rig))).model.noise
    dataclasses.replace(usual, names=uncertain).save(noise)
    command = [sys.executable, "-m", "jaxtwin", "serve", rig, "--virtual", "--speed", str(SPEED)]
    command += ["--faults", fault.format(FAULT_AT), "--noise", str(noise), "--allow-control"]
    return subprocess.Popen([*command, "--port", "0"], stdout=subprocess.PIPE, text=True)


def foil_plate(folder: Path) -> Path:
    """A rig file of a plate with a cell and a foil heater."""
    file = folder / "foil.toml"
    options = (
        "--width 12cm --height 6cm --thickness 2mm --material aluminium --zones 4x2 "
        "--module TEC1-12706 --at 3cm,3cm --heater foil,20W,9cm,3cm --supply-voltage 12V"
    )
    command = [sys.executable, "-m", "jaxtwin", "new-rig", str(file), *options.split()]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return file


def draw_all(page: Page, folder: Path, name: str) -> None:
    folder.mkdir(exist_ok=True, parents=True)
    for width in WIDTHS:
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            page.set_viewport_size({"width": width, "height": 900})
            draw(page, folder / f"{name}-{width}-{scheme}.png")
    page.emulate_media(color_scheme="light")
    page.set_viewport_size({"width": 1600, "height": 900})


def draw(page: Page, file: Path, clip: FloatRect | None = None) -> None:
    page.wait_for_timeout(700)  # until charts have taken a new width
    page.screenshot(path=file, full_page=True, clip=clip)
    Image.open(file).convert("RGB").quantize(256).save(file, optimize=True)
    print(file)


if __name__ == "__main__":
    main()

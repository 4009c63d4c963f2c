"""The picture of the page in serve.md, and pages of other widths to look at.

    python docs/make_page_picture.py [FOLDER]

Needs Playwright and Chromium (`pip install playwright`, Debian's package `chromium`), and takes
three minutes: a virtual rig is driven at five times its speed, a contact comes loose after ten
minutes of it, and the page is drawn as soon as it is diagnosed. With a folder it is also drawn at
390, 1280 and 2560 pixels, light and dark.
"""

import dataclasses
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import FloatRect, Page, sync_playwright

import jaxtwin as jt
from jaxtwin.observers import live_observer

RIG, SPEED, FAULTS = "dual-cell", 5, "loosen=P1@600/4"
UNCERTAIN = ("R_pc1_row1", "R_pc2_row1", "R_sink1")
DUTY = [0.5, 0.35]
WAIT_MS = 300_000
"""The longest time until the contact is diagnosed, ms."""

PICTURE = Path(__file__).parent / "images" / "serve.png"
DRIVE = """([token, duty]) => fetch('/control/drive', {method: 'POST',
    headers: {'content-type': 'application/json', authorization: `Bearer ${token}`},
    body: JSON.stringify({duty, seconds: 3600})})"""


def main() -> None:
    """Serves, waits and draws."""
    with tempfile.TemporaryDirectory() as folder:
        noise = Path(folder) / "noise.toml"
        usual = live_observer(jt.Twin(RIG)).model.noise
        dataclasses.replace(usual, names=UNCERTAIN).save(noise)
        command = [sys.executable, "-m", "jaxtwin", "serve", RIG, "--virtual", "--speed"]
        command += [str(SPEED), "--faults", FAULTS, "--noise", str(noise), "--allow-control"]
        server = subprocess.Popen([*command, "--port", "0"], stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            text = next(line for line in server.stdout if "#" in line)
            address, token = re.findall(r"(http://[^\s#]+)#(\S+)", text)[0]
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path="/usr/bin/chromium")
                page = browser.new_page(viewport={"width": 1600, "height": 900})
                page.goto(address)
                page.evaluate(DRIVE, [token, DUTY])
                page.wait_for_selector(".cause", timeout=WAIT_MS)
                parameters = page.locator(".parameters").bounding_box()
                assert parameters is not None
                height = round(parameters["y"] + parameters["height"] + 12)
                draw(page, PICTURE, {"x": 0, "y": 0, "width": 1600, "height": height})
                if len(sys.argv) > 1:
                    draw_all(page, Path(sys.argv[1]))
                browser.close()
        finally:
            server.terminate()
            server.wait()


def draw(page: Page, file: Path, clip: FloatRect | None = None) -> None:
    page.wait_for_timeout(1500)  # until charts have taken a new width
    page.screenshot(path=file, full_page=True, clip=clip)
    Image.open(file).convert("RGB").quantize(256).save(file, optimize=True)
    print(file)


def draw_all(page: Page, folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    for width in (390, 1280, 2560):
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            page.set_viewport_size({"width": width, "height": 900})
            draw(page, folder / f"page-{width}-{scheme}.png")


if __name__ == "__main__":
    main()

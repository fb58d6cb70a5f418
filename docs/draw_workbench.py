"""Draws docs/workbench.png, the picture in the README: the workbench on the demo's result, in headless Chromium.

./run python docs/draw_workbench.py
"""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

WIDTH, HEIGHT, COLOURS = 1180, 1240, 48
HERE = Path(__file__).parent


def main() -> None:
    """Run the demo, open the workbench on its folder, and store what it shows with few colours."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        sys.exit("draw_workbench.py needs Chromium: apt-get install chromium")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "laboratory"
        folder.mkdir()
        odescope = [sys.executable, "-m", "odescope"]
        subprocess.run([*odescope, "demo", "--out", str(folder / "pendulum")], check=True, capture_output=True)
        command = [*odescope, "workbench", str(folder), "--no-browser"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server:
            try:
                picture = taken(chromium, address_of(server))
            finally:
                server.terminate()
    with Image.open(io.BytesIO(picture)) as image:
        image.convert("RGB").quantize(COLOURS).save(HERE / "workbench.png", optimize=True)
    print(f"wrote docs/workbench.png, {(HERE / 'workbench.png').stat().st_size // 1000} kB")


def address_of(server: subprocess.Popen[str]) -> str:
    """Return the address that a workbench prints."""
    assert server.stderr is not None
    for line in server.stderr:
        if found := re.search(r"http://\S+", line):
            return found[0]
    sys.exit("the workbench does not begin")


def taken(chromium: str, address: str) -> bytes:
    """Return a picture of the demo's result."""
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        page.goto(address)
        page.goto(address.split("/?")[0] + "/look")
        page.get_by_text("with Shift held").wait_for(timeout=120_000)
        page.wait_for_timeout(1000)  # charts are drawn after they are there
        picture: bytes = page.screenshot()
        browser.close()
        return picture


if __name__ == "__main__":
    main()

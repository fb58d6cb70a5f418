"""Draws docs/report.png, the picture in the README: the head of the demo's report in headless Chromium.

./run python docs/draw_report.py
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

WIDTH, HEIGHT, COLOURS = 1060, 1490, 48
HERE = Path(__file__).parent


def main() -> None:
    """Run the demo, take a picture of its report, and store it with few colours, which is all that it has."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        sys.exit("draw_report.py needs Chromium: apt-get install chromium")
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "odescope", "demo", "--out", folder], check=True, capture_output=True)
        shot = Path(folder) / "shot.png"
        subprocess.run(
            [
                chromium, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--screenshot={shot}",
                f"--window-size={WIDTH},{HEIGHT}", f"--user-data-dir={folder}/profile",
                (Path(folder) / "report.html").as_uri(),
            ],
            check=True,
            capture_output=True,
        )  # fmt: skip
        with Image.open(shot) as image:
            image.convert("RGB").quantize(COLOURS).save(HERE / "report.png", optimize=True)
    print(f"wrote docs/report.png, {(HERE / 'report.png').stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: Apache-2.0
"""Draw the arm of a page of `fjr run` as a moving picture, with the headless browser of the tests.

python tools/docs/moving_picture.py runs/arm7 docs/figures/arm7.gif
"""

from __future__ import annotations

import argparse
import io
import sys
from base64 import b64decode
from pathlib import Path

from PIL import Image
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from system.browser import Browser  # type: ignore[import-not-found]  # noqa: E402

FRAMES, PERIOD = 48, 0.1  # s of the run between two frames
WIDTH, COLOURS = 480, 48  # pixels of the picture; of the palette
PLACE = """(({ x, y, width, height }) => ({ x, y, width, height }))(
  document.querySelector(".stage").getBoundingClientRect())"""


def main() -> int:
    """Write the picture."""
    parser = argparse.ArgumentParser(description="Draw the arm of a page of `fjr run` as a moving picture.")
    parser.add_argument("run", type=Path, help="folder of a run of at least 5 s")
    parser.add_argument("picture", type=Path, help="GIF to write")
    given = parser.parse_args()
    browser = Browser()
    try:
        browser.open(given.run / "report.html", width=760)
        frames = [_frame(browser, k * PERIOD) for k in tqdm(range(FRAMES))]
    finally:
        browser.close()
    first, *others = (frame.quantize(COLOURS) for frame in frames)
    first.save(given.picture, save_all=True, append_images=others, duration=round(1e3 * PERIOD), loop=0, optimize=True)
    print(f"{given.picture}: {given.picture.stat().st_size // 1024} kB")
    return 0


def _frame(browser: Browser, t: float) -> Image.Image:
    """Return the stage of the arm at t [s] of the run."""
    slider = "document.querySelector('#arm .time')"
    browser.value(f"{slider}.value = {t}; {slider}.dispatchEvent(new Event('input'))")
    browser.settle()
    shot = browser.call("Page.captureScreenshot", clip={**browser.value(PLACE), "scale": 1})
    frame = Image.open(io.BytesIO(b64decode(shot["data"]))).convert("RGB")
    return frame.resize((WIDTH, round(WIDTH * frame.height / frame.width)))


if __name__ == "__main__":
    sys.exit(main())

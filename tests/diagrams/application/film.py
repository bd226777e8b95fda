"""A Meshcat recording as a film that plays by itself, such as the one in the README.

make demo
python tests/diagrams/application/film.py demo/recording.html docs/images/demo.webp
"""

from __future__ import annotations

import argparse
import base64
import io
from pathlib import Path

from browser import Browser
from PIL import Image

SIZE = (800, 500)  # px
FRAMES = 60
SHOWN, LAST = 200, 2500  # ms of a frame, and of the last one

LOADING = 20_000  # ms until meshes and their textures are there, too
READY = f"""((at) => window.viewer && viewer.animator.actions.length && Date.now() - at > {LOADING}
    ? viewer.animator.duration : null)(window.begun ??= Date.now())"""
TAKEN = """(viewer.animator.pause(), {frames}.map(
    time => (viewer.animator.seek(time), viewer.capture_image({width}, {height}))))"""


def main() -> None:
    """Take pictures at even times of the recording and write the film."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    asked.add_argument("recording", type=Path)
    asked.add_argument("film", type=Path)
    told = asked.parse_args()
    page = told.recording.resolve()
    with Browser() as browser:
        duration = browser.opened(page, READY).answer
        times = [duration * place / (FRAMES - 1) for place in range(FRAMES)]
        script = TAKEN.format(frames=times, width=SIZE[0], height=SIZE[1])
        taken = browser.opened(page, f"{READY} && {script}").answer
    pictures = [
        Image.open(io.BytesIO(base64.b64decode(one.partition(",")[2]))).convert("RGB") for one in taken
    ]
    pictures[0].save(
        told.film, save_all=True, append_images=pictures[1:], quality=60, method=6, loop=0,
        duration=[SHOWN] * (FRAMES - 1) + [LAST],
    )  # fmt: skip


if __name__ == "__main__":
    main()

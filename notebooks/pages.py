"""Pictures of HTML pages, for notebooks that write one."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from IPython.display import Image

_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--hide-scrollbars",
    "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage", "--virtual-time-budget=4000",
)  # fmt: skip
_PATIENCE = 60.0  # s for a browser to draw a page


def page_shown(page: Path, height: int) -> Image | str:
    """The upper part of a page as a notebook shows it; without a browser, where to find the page.

    Args:
        page: HTML file that needs no network.
        height: of the window, pixels.
    """
    picture = page_picture(page, 1000, height)
    return f"open {page} in a browser" if picture is None else Image(picture)


def page_picture(page: Path, width: int = 1000, height: int = 700) -> bytes | None:
    """PNG of the upper part of a page.

    Args:
        page: HTML file that needs no network.
        width: of the browser's window, pixels.
        height: of the window, pixels.

    Returns:
        The picture; None without Chromium or Chrome, or if the browser makes none.

    Raises:
        FileNotFoundError: there is no such page.
    """
    address = page.resolve(strict=True).as_uri()
    program = next((path for name in _BROWSERS if (path := shutil.which(name))), None)
    if program is None:
        return None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        picture = Path(folder) / "page.png"
        command = [
            program, *_FLAGS, f"--user-data-dir={folder}/profile", f"--window-size={width},{height}",
            f"--screenshot={picture}", address,
        ]  # fmt: skip
        try:
            subprocess.run(command, capture_output=True, check=False, timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            return None
        return picture.read_bytes() if picture.is_file() else None

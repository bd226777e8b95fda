"""Pages in headless Chromium, spoken to by its debugging protocol: what they load, say, and show."""

from __future__ import annotations

import asyncio
import base64
import io
import json
import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
from tornado.websocket import WebSocketClientConnection, websocket_connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-quic",
    "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage", "--hide-scrollbars", "--remote-debugging-port=0",
)  # fmt: skip
PATIENCE = 90.0
"""s for the browser to start, and for a page to load and be as wanted."""

WINDOWS = {1280: 800, 800: 600}
"""Width and height of windows in which pages are to be legible, px."""

LOADED = 'document.readyState === "complete" ? true : null'
"""Script that waits until a page and its pictures are there."""

LEGIBLE = Path(__file__).with_name("legible.js").read_text(encoding="utf-8")
"""Script that measures what a window shows, see `Measured`."""


@dataclass(frozen=True)
class Measured:
    """What a window shows of a page.

    Attributes:
        wide: px of the page; no more than the window has, or one would have to scroll sideways.
        cut: what sticks out of the window beside what can be scrolled by itself, in words.
        letters: size (px) and beginning of the smallest text that can be seen.
        unloaded: pictures that did not load, by their alternative texts.
        shrunk: share of its own width to which the most shrunken picture is scaled, 1 where there is none.
        canvas: (width, height) of the largest canvas, px; zeros where there is none.
    """

    wide: float
    cut: list[str]
    letters: tuple[float, str]
    unloaded: list[str]
    shrunk: float
    canvas: tuple[float, float]


@dataclass
class Opened:
    """What became of a page.

    Attributes:
        errors: on its console, and exceptions that nothing caught.
        addresses: it asked for, other than `data:` and `blob:`.
        answer: of the script that was waited for.
        shown: by the width of the window.
        pictures: PNG of it, by the width of the window.
    """

    errors: list[str] = field(default_factory=list)
    addresses: list[str] = field(default_factory=list)
    answer: Any = None
    shown: dict[int, Measured] = field(default_factory=dict)
    pictures: dict[int, bytes] = field(default_factory=dict)


def colours(picture: bytes) -> int:
    """Number of colours in a PNG, those that nearly agree counted once: how much is drawn in it."""
    levels = (matplotlib.image.imread(io.BytesIO(picture))[:, :, :3] * 31).astype(int)
    return len(np.unique(levels.reshape(-1, 3), axis=0))


def chromium() -> str | None:
    """Where the browser is, if there is one."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """A browser that is started once and opens one page after another. Use as a context manager."""

    def __enter__(self) -> Browser:
        program = chromium()
        assert program is not None
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        arguments = [program, *FLAGS, f"--user-data-dir={self._profile.name}", "about:blank"]
        self._process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._debugger = ""
        return self

    def __exit__(self, *raised: object) -> None:
        self._process.terminate()
        self._process.wait(timeout=PATIENCE)
        self._profile.cleanup()

    def opened(self, page: Path, script: str = LOADED) -> Opened:
        """Open a page, wait until a script in it has an answer, and look at it in all `WINDOWS`.

        Args:
            page: file.
            script: JavaScript expression; evaluated until it is neither null nor an error.

        Raises:
            TimeoutError: it has none in time; the text has what was on the console.
        """
        self._debugger = self._debugger or _debugger(Path(self._profile.name))
        return asyncio.run(_visit(self._debugger, page.as_uri(), script))


LETTERS = 11.0
"""Least size of text, px."""

PICTURES = 0.97
"""Least share of its own width that a picture keeps; letters in it have 8 points, 10.7 px, and more."""


def assert_legible(seen: Opened, page: Path) -> None:
    """The page says no error, asks for nothing but itself, and can be read in every window.

    Args:
        seen: the page, opened.
        page: its file.
    """
    assert seen.errors == []
    assert seen.addresses == [page.as_uri()]
    assert set(seen.shown) == set(WINDOWS)
    for width, shown in seen.shown.items():
        assert shown.wide <= width, f"{page.name} is {shown.wide} px wide in a window of {width} px"
        assert shown.cut == [], f"in a window of {width} px"
        assert shown.letters[0] >= LETTERS, f"{page.name}: {shown.letters} in a window of {width} px"
        assert shown.unloaded == []
        assert shown.shrunk >= PICTURES, f"in a window of {width} px"


def _debugger(profile: Path) -> str:
    """Address of the browser's debugging protocol, once it has written it down."""
    place = profile / "DevToolsActivePort"
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        lines = place.read_text(encoding="utf-8").split() if place.is_file() else []
        if len(lines) == 2:
            return f"ws://127.0.0.1:{lines[0]}{lines[1]}"
        time.sleep(0.05)
    raise TimeoutError("the browser did not start")


class _Tab:
    """A page's end of the protocol. Events that come while an answer is awaited are noted."""

    def __init__(self, socket: WebSocketClientConnection) -> None:
        self._socket = socket
        self._number = 0
        self._session: str | None = None
        self.noted = Opened()

    async def begin(self) -> None:
        self._target = (await self.ask("Target.createTarget", url="about:blank"))["targetId"]
        session = await self.ask("Target.attachToTarget", targetId=self._target, flatten=True)
        self._session = session["sessionId"]
        for domain in ("Runtime", "Log", "Network", "Page"):
            await self.ask(f"{domain}.enable")

    async def resize(self, width: int) -> None:
        size = {"width": width, "height": WINDOWS[width], "deviceScaleFactor": 1, "mobile": False}
        await self.ask("Emulation.setDeviceMetricsOverride", **size)

    async def close(self) -> None:
        self._session = None
        await self.ask("Target.closeTarget", targetId=self._target)

    async def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        await self._socket.write_message(json.dumps(message))
        while True:
            text = await self._socket.read_message()
            assert text is not None, "the browser went away"
            answer = json.loads(text)
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self._note(answer.get("method"), answer.get("params", {}))

    def _note(self, event: str | None, what: dict[str, Any]) -> None:
        if event == "Runtime.exceptionThrown":
            details = what["exceptionDetails"]
            self.noted.errors.append(details.get("exception", {}).get("description", details["text"]))
        elif event == "Runtime.consoleAPICalled" and what["type"] in ("error", "assert"):
            self.noted.errors.append(" ".join(str(part.get("value", part)) for part in what["args"]))
        elif event == "Log.entryAdded" and what["entry"]["level"] == "error":
            self.noted.errors.append(f"{what['entry']['text']} {what['entry'].get('url', '')}")
        elif event == "Network.requestWillBeSent":
            url = what["request"]["url"]
            if not url.startswith(("data:", "blob:", "about:")):
                self.noted.addresses.append(url)
        elif event == "Network.webSocketCreated":
            self.noted.addresses.append(what["url"])


async def _visit(debugger: str, address: str, script: str) -> Opened:
    socket = await websocket_connect(debugger, max_message_size=2**28)
    tab = _Tab(socket)
    await tab.begin()
    await tab.resize(next(iter(WINDOWS)))
    await tab.ask("Page.navigate", url=address)
    until = time.monotonic() + PATIENCE
    while True:
        said = await tab.ask("Runtime.evaluate", expression=script, returnByValue=True)
        tab.noted.answer = said["result"].get("value")
        if "exceptionDetails" not in said and tab.noted.answer is not None:
            break
        if time.monotonic() > until:
            raise TimeoutError(f"{address}: no answer to the script; {said}; console: {tab.noted.errors}")
        await asyncio.sleep(0.1)
    for width in WINDOWS:
        await tab.resize(width)
        await asyncio.sleep(0.3)  # what was drawn last is to be in the picture
        told = await tab.ask("Runtime.evaluate", expression=LEGIBLE, returnByValue=True)
        tab.noted.shown[width] = Measured(**told["result"]["value"])
        picture = await tab.ask("Page.captureScreenshot", format="png")
        tab.noted.pictures[width] = base64.b64decode(picture["data"])
    await tab.close()
    socket.close()
    return tab.noted

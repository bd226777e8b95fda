"""Pages in headless Chromium, spoken to by its debugging protocol: what they load, say, and show."""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tornado.websocket import WebSocketClientConnection, websocket_connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-quic",
    "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage", "--hide-scrollbars", "--window-size=1000,750", "--remote-debugging-port=0",
)  # fmt: skip
PATIENCE = 90.0
"""s for the browser to start, and for a page to load and be as wanted."""


@dataclass
class Opened:
    """What became of a page.

    Attributes:
        errors: on its console, and exceptions that nothing caught.
        addresses: it asked for, other than `data:` and `blob:`.
        answer: of the script that was evaluated in it, see `opened`.
        picture: PNG of it.
    """

    errors: list[str] = field(default_factory=list)
    addresses: list[str] = field(default_factory=list)
    answer: Any = None
    picture: bytes = b""


def chromium() -> str | None:
    """Where the browser is, if there is one."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


def opened(address: str, script: str) -> Opened:
    """Open a page, wait until a script in it has an answer, and take a picture.

    Args:
        address: of the page.
        script: JavaScript expression; evaluated until it is neither null nor an error.

    Raises:
        TimeoutError: it has none in time; the text has what was on the console.
    """
    program = chromium()
    assert program is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        arguments = [program, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        browser = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            return asyncio.run(_visit(_debugger(Path(profile)), address, script))
        finally:
            browser.terminate()
            browser.wait(timeout=PATIENCE)


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
        target = await self.ask("Target.createTarget", url="about:blank")
        session = await self.ask("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._session = session["sessionId"]
        for domain in ("Runtime", "Log", "Network", "Page"):
            await self.ask(f"{domain}.enable")

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
    await tab.ask("Page.navigate", url=address)
    until = time.monotonic() + PATIENCE
    while True:
        said = await tab.ask("Runtime.evaluate", expression=script, returnByValue=True)
        tab.noted.answer = said["result"].get("value")
        if "exceptionDetails" not in said and tab.noted.answer is not None:
            break
        if time.monotonic() > until:
            raise TimeoutError(f"{address}: no answer to the script; {said}; console: {tab.noted.errors}")
        await asyncio.sleep(0.2)
    await asyncio.sleep(0.5)  # what was drawn last is to be in the picture
    picture = await tab.ask("Page.captureScreenshot", format="png")
    tab.noted.picture = base64.b64decode(picture["data"])
    socket.close()
    return tab.noted

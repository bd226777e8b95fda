"""Worker processes that end with their parent, however it ends."""

import os
import signal
import threading
import time

_EVERY = 1.0  # s


def prepare_worker() -> None:
    """Ignore Ctrl-C, which the parent handles, and exit within seconds of the parent's end, even if killed.

    Call it first in a worker.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_EVERY)
    os._exit(1)

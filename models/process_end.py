"""Worker processes that end with their parent, however it ends."""

import os
import signal
import threading
import time

_EVERY = 1.0  # s


def prepare_worker(parent: int) -> None:
    """Ignore Ctrl-C, which the parent handles, and exit within seconds of the parent's end, even if killed.

    Call it first in a worker.

    Args:
        parent: number of its process, as the parent knows it: it may have ended before the worker began.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_EVERY)
    os._exit(1)

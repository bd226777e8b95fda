"""Processes that work for another one end with it, however that ends."""

import os
import signal
import threading
import time

_EVERY = 1.0  # s


def prepare_worker() -> None:
    """To be called first in a worker. Ctrl-C is the affair of the process that it works for; where that is
    gone, killed perhaps, so is the worker, within seconds and whatever it is doing."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_EVERY)
    os._exit(1)

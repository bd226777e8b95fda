"""Messages are heard at each step, and while another thread runs Python."""

import subprocess
import sys

from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from slipmap.diagrams.hardware.checked_messages import MessagePump

CHANNELS = [f"CHANNEL_{number}" for number in range(20)]
STEP = 1e-3  # s


class Sender(LeafSystem):
    """Sends a message on each channel at each step."""

    def __init__(self, lcm: DrakeLcm) -> None:
        super().__init__()
        self._lcm = lcm
        self.DeclarePeriodicPublishEvent(STEP, 0.0, self._send)

    def _send(self, context) -> None:
        for number, channel in enumerate(CHANNELS):
            self._lcm.Publish(channel, bytes(50 + 10 * number))


def heard(steps: int) -> dict[str, int]:
    """Number of messages heard on each channel."""
    lcm = DrakeLcm("memq://")
    counts = dict.fromkeys(CHANNELS, 0)

    def hear(channel: str, data: bytes) -> None:
        counts[channel] += 1

    for channel in CHANNELS:
        lcm.Subscribe(channel, lambda data, channel=channel: hear(channel, data))
    builder = DiagramBuilder()
    builder.AddSystem(MessagePump(lcm))
    builder.AddSystem(Sender(lcm))
    Simulator(builder.Build()).AdvanceTo(steps * STEP)
    return counts


def test_what_is_sent_at_a_step_is_heard_at_the_next():
    assert set(heard(100).values()) == {100}


def main() -> None:
    """Hear while another thread makes Python's objects and lets them go."""
    import threading

    sys.setswitchinterval(1e-5)
    threading.Thread(target=_busy, daemon=True).start()
    assert set(heard(3000).values()) == {3000}
    sys.exit(0)


def _busy() -> None:
    while True:
        [bytes(50 + size % 300) for size in range(1000)]


def test_another_thread_may_run_python_meanwhile():
    """Drake's own system in place of the pump ends this with a crash within half a second."""
    ended = subprocess.run([sys.executable, __file__], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr


if __name__ == "__main__":
    main()

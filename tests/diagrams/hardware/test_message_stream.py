"""The process that hears messages: all of them, as they came, in their order."""

from __future__ import annotations

import os
import time

from slipmap.diagrams.hardware.message_stream import TICK, MessageStream
from slipmap.diagrams.hardware.network import open_lcm

URL = f"udpm://239.255.76.67:{7740 + os.getpid() % 20}?ttl=0"


def test_what_is_sent_is_heard_also_while_nobody_reads():
    stream = MessageStream(URL, ["A", "B"])
    try:
        lcm = open_lcm(URL, listens=False)
        sent = []
        for number in range(60):
            for channel, size in (("A", 10), ("B", 200_000), ("C", 10)):
                data = bytes([number]) * size
                lcm.Publish(channel, data)
                sent.append((channel, data))
            time.sleep(0.005)
        wanted = [row for row in sent if row[0] != "C"]
        heard, ticks = [], 0
        for event in stream:
            if event.channel == TICK:
                ticks += 1
                if ticks > 2:
                    break
                continue
            assert abs(1e-6 * event.utime - time.time()) < 30.0
            heard.append((event.channel, event.data))
    finally:
        stream.close()
    assert [row for row in wanted if row in heard] == heard  # in their order, and nothing else
    assert len(heard) > 0.8 * len(wanted)  # LCM itself drops what comes while this computer is busy

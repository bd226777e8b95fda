"""Logs of messages: the format of LCM's logger; files that are none, cut off or damaged."""

from __future__ import annotations

import io

import numpy as np
import pytest

from slipmap.diagrams.hardware.message_stream import BadLog, Event, LogReader

EVENTS = [
    Event(0, 1_700_000_000_000_000, "IIWA_STATUS", b"abc"),
    Event(1, 1_700_000_000_005_000, "CAMERA_DEPTH", bytes(range(256))),
    Event(2, 1_700_000_000_005_001, "ä", b""),
]
WHOLE = b"".join(event.encode() for event in EVENTS)


def events(data: bytes) -> tuple[list[Event], bool]:
    reader = LogReader(io.BytesIO(data), "some.lcmlog")
    return list(reader), reader.cut_off


def test_an_event_is_written_as_lcm_specifies_it():
    """Big-endian: sync word, number (8 bytes), time (8), length of the name (4), of the data (4), both."""
    expected = bytes.fromhex("EDA1DA01 0000000000000007 00060A24181E4000 00000002 00000003") + b"ABxyz"
    assert Event(7, 0x00060A24181E4000, "AB", b"xyz").encode() == expected


def test_what_was_written_is_read():
    assert events(WHOLE) == (EVENTS, False)
    assert events(b"") == ([], False)


def test_a_log_that_is_cut_off_anywhere_gives_what_comes_before():
    ends = np.cumsum([0, *(len(event.encode()) for event in EVENTS)])
    for length in range(1, len(WHOLE)):
        count = int(np.searchsorted(ends, length, side="right")) - 1
        assert events(WHOLE[:length]) == (EVENTS[:count], length != ends[count]), length


@pytest.mark.parametrize("data", [b"PK\x03\x04 and more than one header", b"{}", b"\x00" * 100])
def test_files_that_are_no_logs_are_told_with_what_is_wanted(data):
    with pytest.raises(BadLog, match=r"some.lcmlog: is not an LCM log; give one written by `slipmap record"):
        events(data)


def test_damage_is_told_with_its_place():
    place = len(EVENTS[0].encode())
    with pytest.raises(BadLog, match=f"damaged after 1 messages, at byte {place}") as told:
        events(WHOLE[:place] + b"\x00" + WHOLE[place + 1 :])
    assert f"head -c {place}" in str(told.value)


def test_whatever_stands_in_a_file_is_read_or_refused_in_one_paragraph():
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(3000):
        data = bytearray(WHOLE)
        for place in rng.integers(0, len(data), rng.integers(1, 4)):
            data[place] = rng.integers(256)
        try:
            found, cut_off = events(bytes(data))
        except BadLog as error:
            refused += 1
            assert "\n" not in str(error) and "some.lcmlog: is" in str(error)
        else:
            assert len(found) == len(EVENTS) or cut_off
    assert 300 < refused < 2500


def test_a_length_that_cannot_be_is_not_believed():
    """Four bytes must not make the reader ask for four gigabytes."""
    data = bytearray(WHOLE)
    data[24:28] = b"\xff\xff\xff\xff"
    with pytest.raises(BadLog, match="impossible numbers"):
        events(bytes(data))

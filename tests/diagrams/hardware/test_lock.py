"""Two controllers on one address: the second is told who the first is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from slipmap.diagrams.hardware.control import only_controller
from slipmap.diagrams.testing import open_cell
from slipmap.models.files import BadInput

URL, OTHER = "udpm://239.255.76.67:7667?ttl=0", "udpm://239.255.76.67:7668?ttl=0"
HOLDS = """
import sys, time
from slipmap.diagrams.hardware.control import only_controller
with only_controller(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.fixture
def holder():
    process = subprocess.Popen([sys.executable, "-c", HOLDS, URL], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()


def test_the_second_process_is_told_which_is_the_first(holder):
    with pytest.raises(BadInput) as told, only_controller(URL):
        pass
    text = str(told.value)
    assert URL in text and f"process {holder.pid} (" in text and "--lcm" in text
    with only_controller(OTHER):
        pass


def test_addresses_are_the_same_if_their_messages_meet():
    same = "udpm://239.255.76.67:7667", "udpm://239.255.076.67:07667?ttl=1&recv_buf_size=4096"
    with only_controller(URL):
        for url in same:
            with pytest.raises(BadInput, match="drives the arm there"), only_controller(url):
                pass
    with pytest.raises(BadInput, match="the address must look like"), only_controller("udpm://anywhere"):
        pass


def test_a_cell_behind_the_relay_of_faults_is_locked(tmp_path, monkeypatch):
    for part in ("CommandRecorder", "RelayProcess"):
        made = SimpleNamespace(close=lambda: None)
        monkeypatch.setattr(f"slipmap.diagrams.testing.cell.{part}", lambda *arguments, made=made: made)
    with open_cell(URL, tmp_path / "recordings", faulty=True):
        with pytest.raises(BadInput, match="drives the arm there"), only_controller(URL):
            pass
        with only_controller(OTHER), pytest.raises(BadInput, match="drives the arm there"):  # noqa: SIM117
            with open_cell(OTHER, tmp_path / "others", faulty=True):
                pass


def test_a_killed_process_leaves_no_lock(holder):
    os.kill(holder.pid, signal.SIGKILL)
    holder.wait()
    with only_controller(URL):
        pass


def test_a_process_has_the_lock_once_and_lets_go_of_it():
    with only_controller(URL):
        with pytest.raises(BadInput, match=f"this process \\({os.getpid()}\\)"):  # noqa: SIM117
            with only_controller(URL):
                pass
        other = subprocess.run([sys.executable, "-c", HOLDS, URL], capture_output=True, text=True)
        assert f"process {os.getpid()} (" in other.stderr  # it still has the lock
    with pytest.raises(ZeroDivisionError), only_controller(URL):
        raise ZeroDivisionError
    with only_controller(URL):
        pass


def test_a_worker_that_lives_longer_does_not_keep_the_lock():
    """The worker is forked by a process that has the lock, and outlives it."""
    go_on, wait = os.pipe()
    first = os.fork()
    if first == 0:
        with only_controller(URL):
            if os.fork() == 0:
                os.read(go_on, 1)
            os._exit(0)
    os.waitpid(first, 0)
    try:
        with only_controller(URL):
            pass
    finally:
        os.write(wait, b".")
        time.sleep(0.01)


def test_a_lock_that_says_nothing_yet_is_still_a_lock(holder, tmp_path):
    (path,) = (tmp_path / "slipmap").iterdir()
    path.write_text("")
    with pytest.raises(BadInput, match="another process drives"), only_controller(URL):
        pass

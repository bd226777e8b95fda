"""`slipmap doctor`: what is missing is found by trying, and told with the command that gets it."""

import json
import sys
from collections import namedtuple
from pathlib import Path

import pytest

from slipmap.diagrams.application import health
from slipmap.diagrams.application.health import LCM_URL, examine
from slipmap.diagrams.perception.system_libraries import RENDER

GLIB = "ImportError: libglib-2.0.so.0: cannot open shared object file: No such file or directory"


def findings(failures=()):
    """Everything that is found where some code fails: name to finding."""
    failures = dict(failures)

    def attempt(code):
        return next((message for part, message in failures.items() if part in code), None)

    return {finding.name: finding for finding in examine(attempt)}


def test_a_missing_library_is_told_with_its_package():
    found = findings({"import pydrake.all": GLIB})["import pydrake.all"]
    assert found.needed and not found.ok
    assert found.remedy == "sudo apt-get install libglib2.0-0"


def test_a_machine_that_cannot_render_is_told_what_to_install():
    found = findings({RENDER: "ended with exit code -6"})["camera's renderer (EGL)"]
    assert found.needed and not found.ok
    assert found.remedy == "sudo apt-get install libegl1 libgl1-mesa-dri libglib2.0-0"


def test_lcm_is_not_needed_but_told():
    found = findings({"DrakeLcm": "AssertionError: the message sent was not received"})["LCM by multicast"]
    assert not found.needed and not found.ok
    assert "not received" in found.found and "ip route add 224.0.0.0/4 dev lo" in found.remedy


def test_nothing_leaves_this_computer():
    assert LCM_URL.endswith("ttl=0")


def test_packages_of_wrong_version_or_none(monkeypatch):
    monkeypatch.setattr(health, "_required", lambda: ["numpy>=999", "slipmap-lacks-this>=1.2", "click>=8.1"])
    found = findings()
    assert not found["numpy"].ok and ">=999 is needed" in found["numpy"].found
    assert found["numpy"].remedy == f"{sys.executable} -m pip install 'numpy>=999'"
    assert found["slipmap-lacks-this"].found.startswith("not installed")
    assert found["click"].ok


def test_a_cache_that_cannot_be_written(monkeypatch, tmp_path):
    from slipmap.models.physics import compiled

    (tmp_path / "file").touch()
    monkeypatch.setattr(compiled, "CACHE_FOLDER", tmp_path / "file" / "kernels")
    found = findings()["cache of compiled kernels"]
    assert found.needed and not found.ok and "SLIPMAP_CACHE" in found.remedy


def test_a_machine_on_which_nothing_loads_is_told_too(monkeypatch):
    monkeypatch.setitem(sys.modules, "slipmap.models.physics.compiled", None)
    found = findings({"import": "ModuleNotFoundError: No module named 'numba'"})
    cache = found["cache of compiled kernels"]
    assert not cache.ok and "slipmap.models.physics.compiled" in cache.found
    assert not found["compiler (numba)"].ok


@pytest.mark.parametrize(("threads", "ok"), [("1", True), ("999", False), ("many", False)])
def test_threads_that_outnumber_cores(monkeypatch, threads, ok):
    monkeypatch.setattr(health.os, "sched_getaffinity", lambda process: {0, 1}, raising=False)
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    found = findings()["processor cores"]
    assert found.ok is ok and not found.needed and threads in found.found


def test_a_full_disk(monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(health.shutil, "disk_usage", lambda folder: usage(10e9, 9.8e9, 0.2e9))
    found = findings()["disk"]
    assert not found.ok and found.found == "0.2 GB free"


def test_without_a_browser_the_machine_is_still_ready(monkeypatch, slipmap, tmp_path):
    monkeypatch.setattr(health.shutil, "which", lambda name: None)
    monkeypatch.setattr(health, "_in_fresh_interpreter", lambda code: None)
    said = slipmap("doctor", "--json", str(tmp_path / "doctor.json"))
    assert said.code == 0
    assert "without  browser" in said.out and "sudo apt-get install chromium" in said.out
    document = json.loads((tmp_path / "doctor.json").read_text())
    assert document["ready"] is True
    (browser,) = [check for check in document["checks"] if check["name"] == "browser"]
    assert browser["ok"] is False and browser["needed"] is False


def test_what_is_lacking_is_told_and_makes_the_exit_code(monkeypatch, slipmap, tmp_path):
    monkeypatch.setattr(health, "_in_fresh_interpreter", lambda code: GLIB if "cv2" in code else None)
    said = slipmap("doctor", "--json", str(tmp_path / "doctor.json"))
    assert said.code == 2
    assert "missing  import cv2" in said.out and "-> sudo apt-get install libglib2.0-0" in said.out
    assert "this machine lacks import cv2" in said.err
    assert json.loads((tmp_path / "doctor.json").read_text())["ready"] is False


def test_code_is_tried_in_a_process_that_may_die():
    assert health._in_fresh_interpreter("pass") is None
    assert health._in_fresh_interpreter("import os; os.abort()") == "ended with exit code -6"
    assert health._in_fresh_interpreter("raise ValueError('no')") == "ValueError: no"


def test_messages_go_round_here():
    failure = health._in_fresh_interpreter(health._ROUND_TRIP)
    if failure is not None and "not heard" in failure:
        pytest.skip("this machine's loopback carries no multicast")
    assert failure is None


def test_packages_are_those_that_the_project_names():
    import tomllib

    text = (Path(__file__).resolve().parents[3] / "pyproject.toml").read_text()
    assert health._required() == tomllib.loads(text)["project"]["dependencies"]

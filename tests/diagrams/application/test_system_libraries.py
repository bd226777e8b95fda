"""Missing system libraries are installed where that is possible and named where it is not."""

from __future__ import annotations

import importlib.util
import subprocess
from pathlib import Path

import pytest

from slipmap.diagrams.perception.system_libraries import RENDER, RENDERING_PACKAGES

_PLACE = Path(__file__).parents[3] / ".ci" / "system_libraries.py"
_SPEC = importlib.util.spec_from_file_location("installer", _PLACE)
system_libraries = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(system_libraries)
MissingLibrary, MissingRenderer = system_libraries.MissingLibrary, system_libraries.MissingRenderer
install_missing = system_libraries.install_missing


class Machine:
    """Answers commands as a machine would that lacks some libraries."""

    def __init__(self, missing: dict[str, str], *, apt_works: bool = True, sudo_works: bool = True) -> None:
        self.missing = dict(missing)
        self.apt_works, self.sudo_works = apt_works, sudo_works
        self.commands: list[list[str]] = []

    def __call__(self, command):
        self.commands.append(list(command))
        code, error = 0, ""
        if command[1] == "-c":
            module = command[2].removeprefix("import ")
            if module in self.missing:
                code = 1
                error = f"Traceback\nImportError: {self.missing[module]}"
        elif command[:2] == ["sudo", "-n"] and not self.sudo_works:
            code = 1
        elif "install" in command:
            code = 0 if self.apt_works else 100
            if self.apt_works:
                self.missing = {}
        return subprocess.CompletedProcess(command, code, "", error)

    def apt_commands(self):
        return [command for command in self.commands if "apt-get" in command]


GLIB = {"pydrake.all": "libglib-2.0.so.0: cannot open shared object file: No such file or directory"}


@pytest.fixture
def as_user(monkeypatch):
    def become(user: int, *programs: str) -> None:
        monkeypatch.setattr(system_libraries.os, "geteuid", lambda: user)
        found = {name: f"/usr/bin/{name}" for name in programs}
        monkeypatch.setattr(system_libraries.shutil, "which", found.get)

    return become


def test_nothing_is_installed_where_nothing_is_missing(as_user):
    as_user(0, "apt-get")
    machine = Machine({})
    assert install_missing(machine) == []
    assert machine.apt_commands() == []


def test_root_installs(as_user):
    as_user(0, "apt-get")
    machine = Machine(GLIB)
    assert install_missing(machine) == ["libglib2.0-0"]
    update, install = machine.apt_commands()
    assert "update" in update and install[-1] == "libglib2.0-0"
    assert "sudo" not in install


def test_a_user_with_passwordless_sudo_installs(as_user):
    as_user(1000, "apt-get", "sudo")
    machine = Machine(GLIB)
    assert install_missing(machine) == ["libglib2.0-0"]
    assert all(command[:2] == ["sudo", "-n"] for command in machine.apt_commands())


@pytest.mark.parametrize(
    ("user", "programs", "machine"),
    [
        (1000, ("apt-get",), Machine(GLIB)),
        (1000, ("apt-get", "sudo"), Machine(GLIB, sudo_works=False)),
        (0, ("apt-get",), Machine(GLIB, apt_works=False)),
        (0, (), Machine(GLIB)),
    ],
    ids=["no sudo", "sudo wants a password", "apt-get fails", "no apt-get"],
)
def test_otherwise_the_command_is_named(as_user, user, programs, machine):
    as_user(user, *programs)
    with pytest.raises(MissingLibrary, match=r"libglib-2\.0\.so\.0.*sudo apt-get install libglib2\.0-0"):
        install_missing(machine)


def test_an_unknown_library_is_named(as_user):
    as_user(0, "apt-get")
    machine = Machine({"cv2": "libodd.so.3: cannot open shared object file: No such file or directory"})
    with pytest.raises(MissingLibrary, match=r"`import cv2`.*libodd\.so\.3"):
        install_missing(machine)
    assert machine.apt_commands() == []


def test_another_failure_of_an_import_is_shown_as_it_is(as_user):
    as_user(0, "apt-get")
    with pytest.raises(MissingLibrary, match="No module named 'cv2'"):
        install_missing(Machine({"cv2": "No module named 'cv2'"}))


def test_this_machine_has_what_drake_and_opencv_need():
    assert install_missing() == []


def test_what_rendering_needs_is_installed(as_user):
    as_user(0, "apt-get")
    machine = Machine({RENDER: "Segmentation fault"})
    assert install_missing(machine) == list(RENDERING_PACKAGES)


def test_without_a_renderer_the_rest_is_installed(as_user, capsys, monkeypatch):
    as_user(1000, "apt-get")
    machine = Machine({RENDER: "Segmentation fault"})
    with pytest.raises(MissingRenderer, match="sudo apt-get install libegl1"):
        install_missing(machine)
    monkeypatch.setattr(system_libraries, "_run", machine)
    assert system_libraries.main() == 0
    assert "simulated camera" in capsys.readouterr().err

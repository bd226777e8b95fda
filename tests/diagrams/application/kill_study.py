"""Every command ended at ten moments: `python -m tests.diagrams.application.kill_study FOLDER`.

Each runs to its end twice, the first time to compile its kernels, and then again and again, ended by SIGINT
and SIGKILL at ten moments of the second run's time. Said is what is wrong then: another exit code than 130
(or that of the whole run, where the signal came too late, or where Ctrl-C is how the command ends), a
traceback, a process left behind, a file that is not whole or has no place beside the others, and whether the
same command, or `--resume`, goes on afterwards.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import trimesh
import yaml

import slipmap
from slipmap.diagrams.hardware.mcap_log import McapLog
from slipmap.models.measurements import write_dataset
from tests.hardware.made_up_cell import MadeUpCell
from tests.models.measurements.importing.lab_session import lab_session

MARK = "SLIPMAP_KILL_STUDY"
"""Environment variable by which processes that a command left behind are known."""
SMALL = "camera: {width: 480, height_pixels: 360, rate: 5.0}\nsimulation: {time_step: 0.005}\n"


@dataclass(frozen=True)
class Case:
    """A command, and how it goes on."""

    words: str  # after `slipmap`; {out} is the folder that it writes to, {data} that of its input
    again: str | None = None  # what goes on with it; itself unless given, where it may be repeated
    served: bool = False  # whether Ctrl-C is how it ends, so that it is well
    seconds: float = 8.0  # that it is left alone for, where it ends by Ctrl-C alone


CASES = {
    "doctor": Case("doctor"),
    "demo": Case("demo -o {out}/demo"),
    "explore": Case(
        "explore --scenario {data}/cell.yaml --pushes 2 --checks 0 --out {out}/run --json {out}/run/r.json"
        " --record {out}/run/run.html",
        again="explore --resume {out}/run",
    ),
    "pregrasp": Case("pregrasp --scenario {data}/cell.yaml --pushes 1 --out {out}/run"),
    "station": Case("station --scenario {data}/cell.yaml --lcm udpm://239.255.76.97:7697?ttl=0", served=True),
    "record": Case(
        "record --lcm udpm://239.255.76.97:7698?ttl=0 -o {out}/pushes --log {out}/log.mcap", served=True
    ),
    "replay": Case("replay {data}/log.mcap --scenario {data}/made_up.yaml -o {out}/replay --hypotheses 4"),
    "object": Case("object {data}/ring.stl -o {out}/ring.yaml --finger 0.008"),
    "import": Case(
        "import {data}/take_001.csv {data}/robot.log {data}/force.csv --setup {data}/setup.yaml -o"
        " {out}/pushes"
    ),
    "check": Case("check {data}/pushes -o {out}/check.html --json {out}/check.json"),
    "identify": Case("identify {data}/pushes -o {out}/belief.npz --json {out}/belief.json"),
    "predict": Case("predict {data}/pushes --belief {data}/belief.npz -o {out}/p.png --json {out}/p.json"),
    "view": Case("view {data}/belief.npz --html {out}/view.html"),
    "compare": Case("compare {data}/pushes --belief {data}/belief.npz -o {out}/c.html --json {out}/c.json"),
    "diagnose": Case("diagnose {data}/pushes --quick -o {out}/d.html --json {out}/d.json"),
    "fit": Case("fit {data}/pushes --effect table_tilt -o {out}/fit.npz --json {out}/fit.json"),
    "effects": Case("effects table_tilt --picture {out}/tilt.png --json {out}/tilt.json"),
    "export": Case("export {data}/belief.npz --to sdf -o {out}/sdf"),
    "calibrate": Case("calibrate --objects 2 -o {out}/cal.png --json {out}/cal.json"),
    "explore-study": Case(
        "explore-study --object hammer --runs 1 --pushes 1 --checks 1 -o {out}/study --json {out}/study.json"
    ),
    "campaign": Case("campaign fig4 --objects hammer --trials 2 -o {out}/campaign --json {out}/c.json"),
    "blind-test": Case("blind-test --count 1 -o {out}/blind"),
    "audit": Case("audit drake -o {out}/audit.html --json {out}/audit.json"),
    "bench": Case("bench --json {out}/bench.json"),
    "completion": Case("completion bash"),
}  # fmt: skip


def main() -> None:
    """End the commands that are named, or all."""
    reader = argparse.ArgumentParser(description=__doc__)
    reader.add_argument("folder", type=Path)
    reader.add_argument("commands", nargs="*", metavar="COMMAND", default=list(CASES))
    reader.add_argument("--moments", type=int, default=10)
    asked = reader.parse_args()
    data = made_data(asked.folder / "data")
    for name in asked.commands:
        out, case, faults, stopped = asked.folder / "out" / name, CASES[name], 0, 0

        def complain(text: str) -> None:
            nonlocal faults
            faults += 1
            print(f"    {text}", flush=True)

        for _ in range(2):
            fresh(out)
            seconds, whole = whole_run(case, out, data)
        print(f"{name}: {seconds:.1f} s", flush=True)
        if whole:
            complain(f"the whole run ends with {whole}")
        for number in (signal.SIGINT, signal.SIGKILL):
            for moment in range(asked.moments):
                fresh(out)
                ended = End(case, out, data, number, (moment + 0.5) / asked.moments * seconds)
                stopped += ended.signalled
                for text in ended.complaints(whole):
                    complain(f"{number.name} at {ended.moment:.1f} s: {text}")
        for text in goes_on(case, out, data):
            complain(text)
        print(f"{name}: {stopped} of {2 * asked.moments} were stopped, {faults} complaints", flush=True)


def fresh(out: Path) -> None:
    """An empty folder."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)


def started(words: str, out: Path, data: Path, mark: str) -> subprocess.Popen[bytes]:
    """The command, with signals as in a terminal."""
    command = [sys.executable, "-m", "slipmap", *words.format(out=out, data=data).split()]
    scratch = out.parent / "tmp"
    scratch.mkdir(exist_ok=True)
    environment = os.environ | {MARK: mark, "TMPDIR": str(scratch)}
    with open(out.parent / f"{out.name}.err", "wb") as errors:
        return subprocess.Popen(
            command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )  # fmt: skip


def whole_run(case: Case, out: Path, data: Path) -> tuple[float, int]:
    """How long the command takes, s, and how it ends."""
    begin = time.monotonic()
    process = started(case.words, out, data, "whole")
    if case.served:
        time.sleep(case.seconds)
        process.send_signal(signal.SIGINT)
    code = process.wait()
    return time.monotonic() - begin, code


class End:
    """A run that was ended, and what it left."""

    def __init__(self, case: Case, out: Path, data: Path, number: signal.Signals, moment: float) -> None:
        self.case, self.out, self.number, self.moment = case, out, number, moment
        self.mark = f"{os.getpid()}-{time.monotonic_ns()}"
        process = started(case.words, out, data, self.mark)
        self.signalled = False
        try:
            process.wait(timeout=moment)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
            self.signalled = True
        self.asked = time.monotonic()
        try:
            self.code = process.wait(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            self.code = 999
        self.took = time.monotonic() - self.asked

    def complaints(self, whole: int) -> Iterator[str]:
        """What is wrong."""
        said = (self.out.parent / f"{self.out.name}.err").read_text(errors="replace")
        if "Traceback" in said and "slipmap" not in said:
            return  # Python itself was still being loaded
        allowed = {whole, 130} if self.number == signal.SIGINT else {whole, -signal.SIGKILL}
        if self.code not in allowed:
            yield f"exit code {self.code}: {said.strip().splitlines()[-1:]}"
        if "Traceback" in said or "internal failure" in said:
            yield f"traceback: {said.strip().splitlines()[-1]}"
        if self.took > 5.0:
            yield f"ended {self.took:.0f} s after the signal"
        left = processes(self.mark)
        if left:
            yield f"left behind: {left}"
        for path in sorted(path for path in self.out.rglob("*") if path.is_file()):
            name = path.relative_to(self.out)
            if path.name.startswith(".slipmap."):  # removed by whoever writes there next
                if self.number == signal.SIGINT:
                    yield f"a file left over: {name}"
            elif (why := broken(path)) is not None:
                yield f"{name} is not whole: {why}"
        scratch = self.out.parent / "tmp"
        found = [path.name for path in scratch.iterdir()]
        if found and self.number == signal.SIGINT:
            yield f"left in the folder for temporary files: {found}"
        shutil.rmtree(scratch)


def processes(mark: str, patience: float = 5.0) -> list[str]:
    """Processes that are still there after some seconds."""
    for _ in range(int(patience / 0.25)):
        found = []
        for place in Path("/proc").iterdir():
            if place.name.isdigit():
                try:
                    if f"{MARK}={mark}".encode() in (place / "environ").read_bytes().split(b"\0"):
                        found.append((place / "cmdline").read_bytes().replace(b"\0", b" ").decode()[:120])
                except OSError:
                    continue
        if not found:
            return []
        time.sleep(0.25)
    return found


def broken(path: Path) -> str | None:
    """Why a file is not whole; None if it is."""
    try:
        if path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix in (".yaml", ".yml"):
            if yaml.safe_load(path.read_text()) is None:
                return "empty"
        elif path.suffix in (".npz", ".zip"):
            with zipfile.ZipFile(path) as archive:
                return archive.testzip()
        elif path.suffix == ".html":
            if not path.read_text().rstrip().endswith("</html>"):
                return "no end"
        elif path.suffix == ".png":
            if not path.read_bytes().endswith(b"IEND\xaeB`\x82"):
                return "no end"
        elif path.stat().st_size == 0 and path.suffix != ".mcap":
            return "empty"
    except (OSError, ValueError, zipfile.BadZipFile, yaml.YAMLError) as error:
        return f"{type(error).__name__}: {error}"
    return None


def goes_on(case: Case, out: Path, data: Path) -> list[str]:
    """What is wrong when the command is given once more after the last kill."""
    if case.served:
        return []
    words = case.words if case.again is None or not any((out / "run").glob("run.json")) else case.again
    process = started(words, out, data, "again")
    code = process.wait()
    said = (out.parent / f"{out.name}.err").read_text(errors="replace").strip().splitlines()
    parts = [f"still left over: {part.relative_to(out)}" for part in out.rglob(".slipmap.*")]
    if code == 0 or any("exists already" in line for line in said):  # the last signal was too late
        return parts
    return [f"`{words}` afterwards: exit code {code}: {said[-1:]}"]


def made_data(folder: Path) -> Path:
    """What the commands take."""
    if (folder / "belief.npz").exists():
        return folder
    folder.mkdir(parents=True)
    (folder / "cell.yaml").write_text(SMALL)
    trimesh.creation.annulus(0.03, 0.05, 0.03).export(folder / "ring.stl")
    dataset = slipmap.simulated_hammer(fit=4, heldout=1)[0]
    write_dataset(dataset, folder / "pushes")
    session = lab_session(folder)
    (folder / "setup.yaml").write_text(session.setup)
    (folder / "made_up.yaml").write_text("camera: {width: 320, height_pixels: 240, fov_y: 0.5, rate: 10.0}\n")
    with open(folder / "log.mcap", "wb") as file:
        log = McapLog(file)
        for event in MadeUpCell().events():
            log.write(event)
        log.close()
    slipmap.identify(dataset, hypotheses=4, seed=0).belief.save(folder / "belief.npz")
    return folder


if __name__ == "__main__":
    main()

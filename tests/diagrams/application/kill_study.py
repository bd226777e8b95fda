"""Every command ended at ten moments: `python -m tests.diagrams.application.kill_study FOLDER [COMMAND ...]`.

Each command first runs to its end and writes down what it does: the modules that it loads, and each time that
it opens a file for writing, makes, renames or removes one. At some of these events, while its workers start,
and amid the work, it is then ended, by SIGINT and SIGKILL. Said is what is wrong: another exit code than 130
(or that of the whole run, where the signal came too late, or where Ctrl-C is its end), a traceback, a process
left behind, a file that is not whole, results that lack some, temporary files that Ctrl-C leaves or that the
next command does not remove, and whether the same command, or `--resume`, goes on afterwards.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import trimesh
import yaml
from pydrake.lcm import DrakeLcm

import slipmap
from slipmap.diagrams.hardware.mcap_log import McapLog, McapReader
from slipmap.models.files import PART, write_json
from slipmap.models.measurements import write_dataset
from tests.hardware.made_up_cell import MadeUpCell
from tests.models.measurements.importing.lab_session import lab_session

MARK = "SLIPMAP_KILL_STUDY"
"""Environment variable by which processes that a command left behind are known."""
PLAN = "SLIPMAP_KILL_PLAN"
"""Environment variable with the event at which a command ends itself; only its first process reads it."""
HOOK = r"""
import atexit, json, os, re, signal, sys

def watch(plan):
    me, own, counts, met, answers = os.getpid(), [False], {}, set(), []
    log = os.open(plan["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    write = os.O_WRONLY | os.O_RDWR | os.O_CREAT
    changing = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.symlink")
    copies = "ask" in plan
    if copies:
        ask, answer = os.open(plan["ask"], os.O_WRONLY), os.open(plan["answer"], os.O_RDONLY)

    def end_a_copy(what):
        for number in (signal.SIGINT, signal.SIGKILL):
            os.write(ask, f"moment {number.value} {what}\n".encode())
            os.read(answer, 1)
            copy = os.fork()
            if not copy:
                os.kill(os.getpid(), number)
                return
            os.write(ask, f"copy {copy}\n".encode())
            os.write(ask, f"ended {os.waitpid(copy, 0)[1]}\n".encode())
            os.read(answer, 1)

    def hook(event, args):
        if event == "import":
            own[0] = own[0] or args[0] == "slipmap.diagrams"  # before, Python is being loaded
            kind, what = "import", args[0]
        elif event in changing or event == "open" and isinstance(args[2], int) and args[2] & write:
            kind, what = "file", str(args[0])
            if what.startswith("/") and not what.startswith(tuple(plan["under"])):
                return
        else:
            return
        if not own[0] or os.getpid() != me:
            return
        counts[kind] = counts.get(kind, 0) + 1
        if copies:
            target = args[1] if event == "os.rename" else what
            name = re.sub(r"[.]slipmap[.]\w+[.]\d+", "part", os.path.basename(target))
            alike = event, re.sub(r"\d+", "0", name)
            if kind == "import" and counts[kind] in plan["imports"] or kind == "file" and alike not in met:
                met.add(alike)
                end_a_copy(f"{event} {target}")
        elif [kind, counts[kind]] == plan["event"]:
            os.write(log, b"signal\n")
            (os.killpg if plan["group"] else os.kill)(me, plan["signal"])
        elif not plan["event"]:
            os.write(log, f"{kind} {event} {what}\n".encode())

    def look(number, frame):
        spent = os.times().user
        if own[0] and os.getpid() == me:
            end_a_copy(f"work of {spent:.0f} s")
            signal.setitimer(signal.ITIMER_VIRTUAL, max(spent, 0.7))

    sys.addaudithook(hook)
    if copies:
        signal.signal(signal.SIGVTALRM, look)
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.7)
        atexit.register(signal.setitimer, signal.ITIMER_VIRTUAL, 0.0)

if "SLIPMAP_KILL_PLAN" in os.environ:
    watch(json.loads(os.environ.pop("SLIPMAP_KILL_PLAN")))
"""
SMALL = "camera: {width: 480, height_pixels: 360, rate: 5.0}\nsimulation: {time_step: 0.005}\n"
COARSE = f"""{(Path(__file__).parent / "audit" / "coulomb_engine.py").read_text()}

class Coarse(CoulombEngine):
    dt = 4e-3
"""
RECORDED = "udpm://239.255.76.98:7698?ttl=0"
PATIENCE = 30.0  # s from the signal to the end of the command; of the processors' work where others run


@dataclass(frozen=True)
class Case:
    """A command, how it goes on, and what it leaves on purpose."""

    words: str  # after `slipmap`; {out} is the folder that it writes to, {data} that of its input
    again: str | None = None  # what goes on with it; itself unless given, where it may be repeated
    until: str = ""  # what it says a second before Ctrl-C ends a whole run, where it ends by that alone
    steps: tuple[str, ...] = ()  # patterns of files that appear one by one; others appear together
    # whether it has processes of its own, or learns after Ctrl-C, for which a copy lacks the threads
    itself: bool = False
    heard: bool = False  # whether messages of an arm and a camera come while it runs


CASES = {
    "doctor": Case("doctor --json {out}/doctor.json"),
    "demo": Case(
        "demo --fit-pushes 2 --heldout-pushes 1 -o {out}/demo --json {out}/demo.json",
        steps=("demo/pushes/*",),
    ),
    "example": Case("example -o {out}/pushes"),
    "explore": Case(
        "explore --scenario {data}/cell.yaml --pushes 1 --checks 0 --output {out}/run --json {out}/run/r.json"
        " --record {out}/run/run.html",
        again="explore --resume {out}/run",
        steps=("run/*",), itself=True,
    ),
    "pregrasp": Case(
        "pregrasp --scenario {data}/cell.yaml --pushes 1 --output {out}/run --json {out}/run/r.json",
        steps=("run/pushes/*", "run/run.json"), itself=True,
    ),
    "station": Case(
        "station --scenario {data}/cell.yaml --lcm udpm://239.255.76.97:7697?ttl=0",
        until="running", itself=True,
    ),
    "record": Case(
        f"record --lcm {RECORDED} --scenario {{data}}/made_up.yaml -o {{out}}/pushes --log {{out}}/log.mcap",
        until="is kept", itself=True, steps=("*",), heard=True,
    ),
    "replay": Case(
        "replay {data}/log.mcap --scenario {data}/made_up.yaml -o {out}/replay --hypotheses 4"
        " --json {out}/replay/r.json",
        steps=("replay/pushes/*",),
    ),
    "object": Case("object {data}/ring.stl -o {out}/ring.yaml --finger 0.008"),
    "import": Case(
        "import {data}/take_001.csv {data}/robot.log {data}/force.csv --setup {data}/setup.yaml -o"
        " {out}/pushes",
        steps=("pushes.png",),
    ),
    "check": Case("check {data}/pushes -o {out}/check.html --json {out}/check.json"),
    "identify": Case(
        "identify {data}/pushes --plain --hypotheses 4 -o {out}/belief.npz --json {out}/belief.json"
    ),
    "predict": Case("predict {data}/pushes --belief {data}/belief.npz -o {out}/p.png --json {out}/p.json"),
    "view": Case("view {data}/belief.npz --html {out}/view.html"),
    "compare": Case("compare {data}/pushes --belief {data}/belief.npz -o {out}/c.html --json {out}/c.json"),
    "diagnose": Case("diagnose {data}/pushes --quick -o {out}/d.html --json {out}/d.json"),
    "fit": Case(
        "fit {data}/pushes --effect table_tilt --hypotheses 4 -o {out}/fit.npz --json {out}/fit.json"
    ),
    "effects": Case("effects table_tilt --picture {out}/tilt.png --json {out}/tilt.json"),
    "export": Case("export {data}/belief.npz --to sdf -o {out}/sdf"),
    "calibrate": Case("calibrate --objects 1 -o {out}/cal.png --json {out}/cal.json"),
    "explore-study": Case(
        "explore-study --object hammer --runs 1 --pushes 1 --checks 1 -o {out}/study --json {out}/study.json",
        steps=("study/*",), itself=True,
    ),
    "campaign": Case(
        "campaign fig4 --objects hammer --trials 2 --workers 2 -o {out}/campaign --json {out}/c.json",
        steps=("campaign/*/*",), itself=True,
    ),
    "blind-test": Case(
        "blind-test --count 2 --jobs 2 -o {out}/blind", steps=("blind/blind-*",), itself=True,
    ),
    "audit": Case("audit {data}/engine.py:Coarse -o {out}/audit.html --json {out}/audit.json"),
    "bench": Case("bench --json {out}/bench.json"),
    "completion": Case("completion bash"),
}  # fmt: skip


@dataclass(frozen=True)
class Moment:
    """When a command is ended: at an event of its own, while its workers start, or amid the work."""

    kind: str  # `import`, `file`, `worker` or `spent`
    what: str  # in words
    number: int = 0  # of the event of this kind, from 1
    after: float = 0.0  # s after the worker's start; or s that the processors worked


def main() -> None:
    """End the commands that are named, or all."""
    reader = argparse.ArgumentParser(description=__doc__)
    reader.add_argument("folder", type=Path)
    reader.add_argument("commands", nargs="*", metavar="COMMAND", default=list(CASES))
    reader.add_argument("--moments", type=int, default=10)
    asked = reader.parse_args()
    folder = asked.folder.resolve()
    data = made_data(folder / "data")
    hook = folder / "hook"
    hook.mkdir(exist_ok=True)
    (hook / "sitecustomize.py").write_text(HOOK)
    for name in asked.commands:
        kind = Study if CASES[name].itself else StudyOfCopies
        kind(name, folder, data, asked.moments).run()


class Study:
    """A command, ended again and again."""

    def __init__(self, name: str, folder: Path, data: Path, moments: int) -> None:
        self.name, self.case, self.data, self.moments = name, CASES[name], data, moments
        self.out, self.hook = folder / "out" / name, folder / "hook"
        self.scratch, self.errors, self.log = (
            folder / "out" / f"{name}.{end}" for end in ("tmp", "err", "log")
        )
        self.faults = self.stopped = 0
        with open(data / "log.mcap", "rb") as file:
            self.events = list(McapReader(file, "log")) if self.case.heard else []
        self.ended_now = threading.Event()

    def run(self) -> None:
        """Say what is wrong."""
        self.runs_whole()  # compiles what is not compiled yet
        with_workers = self.runs_whole()
        self.complete = set(self.together())
        moments = self.chosen(self.log.read_text().splitlines(), with_workers)
        results = ", ".join(sorted(self.complete)) or "none"
        print(
            f"{self.name}: {self.seconds:.0f} s, {self.spent:.0f} s of work, results: {results}", flush=True
        )
        if self.whole:
            self.complain("a whole run", f"ends with {self.whole}: {self.said()[-1:]}")
        for number in (signal.SIGINT, signal.SIGKILL):
            for index, moment in enumerate(moments):
                self.fresh()
                for text in self.ended(moment, number, index):
                    self.complain(f"{number.name} at {moment.what}", text)
        for text in self.goes_on():
            self.complain("afterwards", text)
        count = 2 * len(moments)
        print(f"{self.name}: {self.stopped} of {count} were stopped, {self.faults} complaints", flush=True)

    def runs_whole(self) -> bool:
        """Run the command to its end, and measure it; whether it has processes of its own."""
        self.fresh()
        begin = time.monotonic()
        process = self.started(self.case.words, "whole", [], 0)
        if self.case.until:
            while process.poll() is None and not self.told():
                time.sleep(0.1)
            time.sleep(1.0)
            process.send_signal(signal.SIGINT)
        self.spent, with_workers = 0.0, False
        while process.poll() is None:
            spent, count = spending(process.pid)
            self.spent, with_workers = max(self.spent, spent), with_workers or count > 1
            time.sleep(0.2)
        self.whole = self.finished(process)
        self.seconds = time.monotonic() - begin
        return with_workers

    def complain(self, when: str, text: str) -> None:
        """Say what is wrong."""
        self.faults += 1
        print(f"    {when}: {text}", flush=True)

    def fresh(self) -> None:
        """Begin with empty folders."""
        for folder in (self.out, self.scratch):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        self.log.unlink(missing_ok=True)

    def started(
        self, words: str, mark: str, event: list[object], number: int, **more: object
    ) -> subprocess.Popen[bytes]:
        """The command, which ends itself by a signal at an event, if one is given."""
        command = [sys.executable, "-m", "slipmap", *words.format(out=self.out, data=self.data).split()]
        under = [str(self.out), str(self.scratch)]
        plan = {"event": event, "signal": number, "log": str(self.log), "under": under, "group": False}
        path = os.pathsep.join(filter(None, [str(self.hook), os.environ.get("PYTHONPATH")]))
        environment = os.environ | {MARK: mark, "TMPDIR": str(self.scratch), "PYTHONPATH": path}
        environment[PLAN] = json.dumps(plan | more)
        self.ended_now.clear()
        if self.case.heard:
            threading.Thread(target=self.play, daemon=True).start()
        with open(self.errors, "wb") as errors:
            return subprocess.Popen(
                command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors,
                start_new_session=True, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
            )  # fmt: skip

    def finished(self, process: subprocess.Popen[bytes]) -> int:
        """The exit code of the command; what sent it messages ends too."""
        code = process.wait()
        self.ended_now.set()
        return code

    def play(self) -> None:
        """Send the messages of an arm and a camera once the command listens, until it ends."""
        while not (self.out / "log.mcap").exists():
            if self.ended_now.wait(0.1):
                return
        lcm, begin = DrakeLcm(RECORDED), time.monotonic() + 2.0
        for event in self.events:
            due = begin + 1e-6 * (event.utime - self.events[0].utime)
            if self.ended_now.wait(max(due - time.monotonic(), 0.0)):
                return
            lcm.Publish(event.channel, event.data)

    def said(self) -> list[str]:
        """Lines on standard error."""
        return self.errors.read_text(errors="replace").splitlines()

    def told(self) -> bool:
        """Whether the command, which ends by Ctrl-C alone, has said what is awaited."""
        return self.case.until in " ".join(line.strip() for line in self.said())

    def chosen(self, events: Sequence[str], with_workers: bool) -> list[Moment]:
        """Moments: two while modules are loaded, three at files, two as workers start, others all along."""
        imports = [k for k, event in enumerate(events) if event.startswith("import")]
        first: dict[str, int] = {}  # of its kind: a run writes a file that it has under way all the time
        for k, event in enumerate(events):
            if event.startswith("file"):
                first.setdefault(re.sub(r"[.]slipmap[.]\w+|\d+", "0", event), k)
        found = []
        for there, count in ((imports[: len(imports) // 4], 2), (sorted(first.values()), 3)):
            shares = np.linspace(0.0, 1.0, count if there else 0)
            for k in sorted({there[round(share * (len(there) - 1))] for share in shares}):
                kind, _, what = events[k].partition(" ")
                number = sum(event.startswith(kind) for event in events[: k + 1])
                found.append(Moment(kind, what, number))
        if with_workers:
            found += [Moment("worker", f"{after} s after one started", after=after) for after in (0.02, 0.7)]
        rest = self.moments - len(found)
        shares = (np.arange(rest) + 0.5) / rest
        return found + [
            Moment("spent", f"{share:.0%} of the work", after=share * self.spent) for share in shares
        ]

    def ended(self, moment: Moment, number: signal.Signals, index: int) -> Iterator[str]:
        """What is wrong when the command ends at a moment, of an index.

        At every second one, Ctrl-C reaches its workers too; at every third, it is pressed twice.
        """
        mark = f"{os.getpid()}-{time.monotonic_ns()}"
        event: list[object] = [moment.kind, moment.number] if moment.kind in ("import", "file") else []
        group, twice = number == signal.SIGINT and index % 2 == 0, number == signal.SIGINT and index % 3 == 2
        process = self.started(self.case.words, mark, event, number, group=group)
        send = os.killpg if group else os.kill
        begin = time.monotonic()
        since, asked, spent, before = None, None, 0.0, 0.0
        while process.poll() is None:
            time.sleep(0.01 if event else 0.05)
            now = time.monotonic()
            if asked is not None or not event:
                spent, count = spending(process.pid)
            if asked is not None:
                if twice and now - asked > 0.3:
                    send(process.pid, number)
                    twice = False
                if spent - before > 2 * PATIENCE or now - asked > 20 * PATIENCE:  # or waits for ever
                    process.kill()
            elif event and self.log.exists() and "signal" in self.log.read_text():
                asked, before = now, spending(process.pid)[0]
            elif self.case.until and self.told() and now - begin > 1.5 * self.seconds:
                process.send_signal(signal.SIGINT)
                asked, before = now, spending(process.pid)[0]
            elif not event:
                since = now if since is None and count > 1 else since
                waited = spent if moment.kind == "spent" else -1.0 if since is None else now - since
                if waited >= moment.after:
                    send(process.pid, number)
                    asked, before = now, spent
        code, took = self.finished(process), 0.0 if asked is None else max(spent - before, 0.0)
        self.stopped += code != self.whole
        print(
            f"    ({number.name} at {moment.what}: exit code {code} after {took:.1f} s of work)", flush=True
        )
        yield from self.complaints(number, code, took, self.said())
        if left := processes(mark):
            yield f"left behind: {left}"

    def complaints(
        self, number: signal.Signals, code: int, took: float, said: Sequence[str]
    ) -> Iterator[str]:
        """What is wrong with a command that has ended."""
        allowed = {self.whole, 130} if number == signal.SIGINT else {self.whole, -signal.SIGKILL}
        if code not in allowed:
            yield f"exit code {code}: {said[-1:]}"
        if any("Traceback" in line or "internal failure" in line for line in said):
            yield f"traceback: {said[-1]}"
        if took > PATIENCE:
            yield f"went on for {took:.0f} s after the signal"
        parts = [*self.out.rglob(".slipmap.*")]
        if number == signal.SIGINT:
            yield from (f"a temporary file left over: {part.relative_to(self.out)}" for part in parts)
            if found := [path.name for path in self.scratch.iterdir()]:
                yield f"left in the folder for temporary files: {found}"
        for path in self.files():
            if (why := broken(path)) is not None:
                yield f"{path.relative_to(self.out)} is not whole: {why}"
        there = set(self.together())
        if there and there < self.complete:
            yield f"results without {', '.join(sorted(self.complete - there))}"
        for folder in {part.parent for part in parts}:  # whoever writes there next removes them
            write_json(folder / "next.json", {})
            if still := [part.name for part in folder.glob(f"{PART}*")]:
                yield f"not removed by the next command: {still}"

    def files(self) -> list[Path]:
        """Files in the output that are not temporary."""
        every = (path for path in self.out.rglob("*") if path.is_file())
        own = (path for path in every if not any(part.startswith(".slipmap.") for part in path.parts))
        return sorted(path for path in own if path.name != "next.json")

    def together(self) -> Iterator[str]:
        """Names of the files that appear together."""
        for path in self.files():
            name = str(path.relative_to(self.out))
            if not any(fnmatch(name, pattern) for pattern in self.case.steps):
                yield name

    def goes_on(self) -> Iterator[str]:
        """What is wrong when the command is given once more after the last kill."""
        if self.case.until:
            return
        ran = self.case.again is not None and any((self.out / "run").glob("run.json"))
        words = self.case.again if ran and self.case.again else self.case.words
        code = self.finished(self.started(words, "again", [], 0))
        said = self.said()
        for part in self.out.rglob(".slipmap.*"):
            yield f"still left over: {part.relative_to(self.out)}"
        if code and not any("exists already" in line for line in said):  # where the last signal was too late
            yield f"`{words}`: exit code {code}: {said[-1:]}"


class StudyOfCopies(Study):
    """A command that runs once; at each moment, copies of its process are made and ended."""

    def run(self) -> None:
        """Say what is wrong."""
        self.fresh()
        ask, answer = (self.out.with_name(f"{self.name}.{end}") for end in ("ask", "answer"))
        for pipe in (ask, answer):
            pipe.unlink(missing_ok=True)
            os.mkfifo(pipe)
        self.mark, begin = f"{os.getpid()}-{time.monotonic_ns()}", time.monotonic()
        reader, self.answer = os.open(ask, os.O_RDONLY | os.O_NONBLOCK), os.open(answer, os.O_RDWR)
        more = {"ask": str(ask), "answer": str(answer), "imports": [2, 20, 40, 60, 80, 150, 400, 800, 1200]}
        self.process, self.whole = self.started(self.case.words, self.mark, [], 0, **more), 0
        self.found: list[tuple[str, str, set[str]]] = []
        self.complete, count, rest = set[str](), 0, b""
        while self.process.poll() is None:
            if not select.select([reader], [], [], 0.2)[0] or not (came := os.read(reader, 1 << 16)):
                time.sleep(0.01)
                if count and time.monotonic() - self.since > 60.0 and self.copy:
                    os.kill(self.copy, signal.SIGKILL)
                continue
            *lines, rest = (rest + came).split(b"\n")
            for line in lines:
                word, _, told = line.decode().partition(" ")
                if word == "moment":
                    self.keep(told)
                elif word == "copy":
                    self.copy, self.since = int(told), time.monotonic()
                else:
                    self.judge(os.waitstatus_to_exitcode(int(told)))
                    count += 1
        self.whole, self.complete = self.finished(self.process), set(self.together())
        for when, text, there in self.found:
            if text:
                self.complain(when, text)
            elif there and there < self.complete:
                lacking = f"results without {', '.join(sorted(self.complete - there))}"
                if when.startswith("SIGKILL at os.rename"):
                    print(f"    ({when}: {lacking}, for microseconds)")
                else:
                    self.complain(when, lacking)
        results = ", ".join(sorted(self.complete)) or "none"
        print(f"{self.name}: {time.monotonic() - begin:.0f} s, exit code {self.whole}, results: {results}")
        print(f"{self.name}: {count} copies were ended, {self.faults} complaints", flush=True)

    def keep(self, told: str) -> None:
        """Keep the files as they are before a copy is ended."""
        number, _, self.what = told.partition(" ")
        self.number, self.copy = signal.Signals(int(number)), 0
        self.since, self.spoken = time.monotonic(), len(self.said())
        for folder in (self.out, self.scratch):
            kept = folder.with_name(f"{folder.name}.kept")
            shutil.rmtree(kept, ignore_errors=True)
            shutil.copytree(folder, kept, copy_function=os.link, symlinks=True)
        os.write(self.answer, b"k")

    def judge(self, code: int) -> None:
        """Note what is wrong with an ended copy, and bring the files back."""
        when = f"{self.number.name} at {self.what}"
        for part in sorted(self.out.rglob(f".slipmap.*.{self.process.pid}.*")):  # as if of a dead process
            part.rename(part.with_name(part.name.replace(f".{self.process.pid}.", f".{self.copy}.", 1)))
        said = self.said()[self.spoken :]
        texts = list(self.complaints(self.number, code, time.monotonic() - self.since, said))
        if left := processes(self.mark, apart=str(self.process.pid)):
            texts.append(f"left behind: {left}")
        self.found += [(when, text, set()) for text in texts]
        self.found.append((when, "", set(self.together())))
        if code == 0:
            print(f"    ({when}: goes on to its end)")
        for folder in (self.out, self.scratch):
            for path in folder.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            kept = folder.with_name(f"{folder.name}.kept")
            shutil.copytree(kept, folder, copy_function=os.link, symlinks=True, dirs_exist_ok=True)
        self.copy = 0
        os.write(self.answer, b"b")


def processes(mark: str, apart: str = "", patience: float = 5.0) -> list[str]:
    """Processes with a mark that are still there after some seconds, apart from that of a number."""
    for _ in range(int(patience / 0.25)):
        found = []
        for place in Path("/proc").iterdir():
            if place.name.isdigit() and place.name != apart:
                try:
                    if f"{MARK}={mark}".encode() in (place / "environ").read_bytes().split(b"\0"):
                        found.append((place / "cmdline").read_bytes().replace(b"\0", b" ").decode()[:120])
                except OSError:
                    continue
        if not found:
            return []
        time.sleep(0.25)
    return found


def spending(session: int) -> tuple[float, int]:
    """Seconds that the processors worked for the processes of a session, and how many these are."""
    seconds, count = 0.0, 0
    for place in Path("/proc").iterdir():
        if place.name.isdigit():
            try:
                words = (place / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(words[3]) == session:
                seconds += sum(map(int, words[11:15])) / os.sysconf("SC_CLK_TCK")
                count += 1
    return seconds, count


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
        elif path.name.startswith("."):
            return "it is hidden"
        elif path.stat().st_size == 0 and path.suffix != ".mcap":
            return "empty"
    except (OSError, ValueError, zipfile.BadZipFile, yaml.YAMLError) as error:
        return f"{type(error).__name__}: {error}"
    return None


def made_data(folder: Path) -> Path:
    """What the commands take."""
    if (folder / "belief.npz").exists():
        return folder
    folder.mkdir(parents=True)
    (folder / "cell.yaml").write_text(SMALL)
    (folder / "engine.py").write_text(COARSE)
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

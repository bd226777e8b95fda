"""A soak: the robot explores for a long time in a cell where things go wrong.

    python tests/hardware/soak.py --minutes 60 --seed 0 -o soak
    python tests/hardware/soak.py --minutes 60 --seed 0 --adapt -o soak

The cell is the twin in lockstep (`slipmap.diagrams.testing.twins`), behind all messages and checks, with
the guard's own limits: minutes are those of the simulation. Each session is a process that explores until it
is done, a fault stops it, or it is killed; the next one goes on with its folder, where arm, gripper and
object were left. With `--adapt` the table is secretly tilted and the robot repairs its model. At the end,
what must not be is counted: pushes lost, limits exceeded, memory that grows.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np
from soak_session import COMMANDS, Task, commands_of

from slipmap.diagrams.application.outputs import make_folder
from slipmap.diagrams.application.terminal import note, paragraph, table
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.testing.faults import Fault
from slipmap.models.files import write_json
from slipmap.models.measurements import read_dataset
from slipmap.models.robots import SPEED_LIMITS

OBJECTS = ("hammer", "wrench", "snack")
PUSHES, CHECKS = 3, 12
"""Of each exploration."""

FAULTY = 0.6
"""Share of pushes with a fault."""

PASSING = (
    Fault("status", "delay", 0.015, seconds=1.0),
    Fault("pictures", "stop", seconds=0.6),
    Fault("pictures", "delay", 0.3, seconds=2.0),
    Fault("pictures", "freeze", seconds=2.0),
    Fault("pictures", "zeros", seconds=0.6, band=(0.3, 0.5)),
    Fault("pictures", "nans", seconds=0.6),
    Fault("pictures", "rubbish", seconds=0.6, band=(0.4, 0.6)),
    Fault("pictures", "torn", seconds=0.6, band=(0.4, 0.6)),
    Fault("gripper", "stuck", seconds=0.5),
)
"""Faults that a run may survive."""

STOPPING = (
    Fault("status", "stop"),
    Fault("status", "delay", 0.1),
    Fault("status", "jump", 0.3),
    Fault("status", "back"),
    Fault("arm", "refuse"),
    Fault("pictures", "stop"),
    None,
)
"""Faults that stop it, the last of which kills the process."""

STOPS = 0.2
"""Share of the latter."""

_STAGES = ("looking", "pushing", "recording")
_STOPPED_IN = ("pushing", "diagnosing")  # with `--adapt`; else only the first


@dataclass
class Account:
    """What happened until now.

    Attributes:
        minutes: of simulated time.
        sessions: and how each ended; empty where it was done.
        faults: how often each happened.
        pushes: recorded.
        lost: pushes that were recorded and are not on the disk, or not as they were.
        explorations: that ended with all their pushes; with `adapt`, `tilted` of them with the tilt in the
            model, and `wrong` with another effect.
        growth: MB by which a session grew while it only judged pushes, at most; and in how many minutes. None
            does so with `adapt`.
        joint_speed, tip_speed: largest of all commands, as shares of the limit.
        commands: how many there were.
    """

    minutes: float = 0.0
    sessions: list[str] = field(default_factory=list)
    faults: Counter[str] = field(default_factory=Counter)
    pushes: int = 0
    lost: int = 0
    explorations: int = 0
    tilted: int = 0
    wrong: int = 0
    growth: tuple[float, float] = (0.0, 0.0)
    joint_speed: float = 0.0
    tip_speed: float = 0.0
    commands: int = 0

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {**vars(self), "faults": dict(self.faults)}


def drawn_faults(
    rng: np.random.Generator, first: int, last: int, *, adapt: bool = False
) -> list[tuple[str, int, Fault | None]]:
    """What goes wrong in pushes `first` to `last`, from 1; nothing after what stops a run."""
    plan: list[tuple[str, int, Fault | None]] = []
    for push in range(first, last + 1):
        if rng.random() > FAULTY:
            continue
        stops = rng.random() < STOPS
        menu: tuple[Fault | None, ...] = STOPPING if stops else PASSING
        fault = menu[rng.integers(len(menu))]
        stages = _STAGES if not stops else _STOPPED_IN if adapt and fault is not None else ("pushing",)
        stage = stages[rng.integers(len(stages))]
        if fault is not None:
            fault = Fault(**{**vars(fault), "after": float(rng.uniform(0.0, 4.0))})
        plan.append((stage, push, fault))
        if stops:
            break
    return plan


def soak(minutes: float, seed: int, folder: Path, *, adapt: bool = False) -> Account:
    """Run sessions until so many minutes were simulated.

    Args:
        minutes: of simulated time.
        seed: of objects, pushes, faults and when they happen.
        folder: where all explorations are left, and `soak.json` after each session.
        adapt: whether the table is tilted and the robot repairs its model.
    """
    rng = np.random.default_rng(seed)
    account, number, kept = Account(), 0, dict[str, str]()
    while account.minutes < minutes:
        place = folder / f"{number:03d}"
        make_folder(place)
        task = Task(OBJECTS[number % len(OBJECTS)], PUSHES, CHECKS, int(rng.integers(2**31)), adapt)
        task.faults = drawn_faults(rng, len(kept) + 1, PUSHES + CHECKS, adapt=adapt)
        said = _session(place, task)
        kept = checked(account, place, said, kept)
        _counted(account, place, said, adapt=adapt)
        write_json(folder / "soak.json", {"seed": seed, "adapt": adapt, **account.to_json()})
        end = account.sessions[-1]
        note(f"{account.minutes:.1f} min, {account.pushes} pushes, exploration {number}: {end or 'done'}")
        if not end or not _goes_on(end) or not kept:
            number, kept = number + 1, {}
    return account


def _session(folder: Path, task: Task) -> list[dict[str, Any]]:
    """What a session said."""
    (folder / COMMANDS).unlink(missing_ok=True)
    with open(folder / "said.log", "a", encoding="utf-8") as log:
        done = subprocess.run(
            [sys.executable, str(Path(__file__).with_name("soak_session.py")), str(folder)],
            input=task.to_json() + "\n", stdout=subprocess.PIPE, stderr=log, text=True, check=False,
        )  # fmt: skip
    said = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    with open(folder / "said.log", "a", encoding="utf-8") as log:
        log.write(done.stdout)
    if not said or "end" not in said[-1]:
        raise click.ClickException(f"a session ended without a word; see {folder / 'said.log'}")
    return said


def checked(
    account: Account, folder: Path, said: list[dict[str, Any]], kept: dict[str, str]
) -> dict[str, str]:
    """Digests of the pushes that are on the disk now, after those that must be were looked for."""
    recorded = max(line.get("recorded", 0) for line in said)
    pushes = folder / "pushes"
    names = [trial.name for trial in read_dataset(pushes).trials] if recorded else []
    found = {name: hashlib.sha256((pushes / name).read_bytes()).hexdigest() for name in names}
    changed = sum(found.get(name) != digest for name, digest in kept.items())
    account.lost += changed + max(recorded - len(found), 0)
    account.pushes += len(found) - len(kept)
    return found


def _counted(account: Account, folder: Path, said: list[dict[str, Any]], *, adapt: bool) -> None:
    last = said[-1]
    account.minutes += last["time"] / 60.0
    account.sessions.append(last["end"].partition(": ")[2] or last["end"])
    account.faults.update(last["faults"])
    if last["end"] == "killed":
        account.faults["killed"] += 1
    if not last["end"]:
        account.explorations += 1
        account.tilted += "table_tilt" in last["effects"]
        account.wrong += bool(set(last["effects"]) - {"table_tilt"})
    # Learning from more pushes takes more memory, also from those that a session took over; what grows after
    # that is not given back.
    held = [
        (line["time"], line["resident"])
        for line in said
        if line.get("doing") == "pushing" and line["recorded"] > PUSHES and not adapt
    ][1:]
    if len(held) > 1:
        grown = held[-1][1] - held[0][1], (held[-1][0] - held[0][0]) / 60.0
        account.growth = max(account.growth, grown)
    commands = commands_of(folder)
    if len(commands.times) > 1:
        share = float((np.abs(commands.joint_speeds) / SPEED_LIMITS).max())
        tip = float(commands.tip_speeds.max()) / Scenario().guard.tip_speed
        account.joint_speed = max(account.joint_speed, share)
        account.tip_speed = max(account.tip_speed, tip)
        account.commands += len(commands.times)


def _goes_on(end: str) -> bool:
    """Whether another process can go on: not where the object is lost."""
    return "does not see the object" not in end and "not seen after the push" not in end


@click.command()
@click.option("--minutes", type=click.FloatRange(0.1, 10_000), default=10.0, show_default=True, metavar="N")
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
@click.option(
    "-o", "--output", "folder", type=click.Path(path_type=Path), default=Path("soak"), metavar="DIR"
)
@click.option("--adapt", is_flag=True, help="Tilt the table secretly, and let the robot repair its model.")
def main(minutes: float, seed: int, folder: Path, adapt: bool) -> None:
    """Explore for N simulated minutes in a cell where things go wrong, and count what must not happen."""
    make_folder(folder)
    account = soak(minutes, seed, folder, adapt=adapt)
    table("Faults", ["what", "times"], [[k, str(n)] for k, n in sorted(account.faults.items())], numbers=(1,))
    table(
        "Ends",
        ["how", "times"],
        [[k or "done", str(n)] for k, n in Counter(account.sessions).items()],
        numbers=(1,),
    )
    growth = (
        f"{account.explorations} explorations ended with all pushes, {account.tilted} of them with the tilt"
        f" in the model and {account.wrong} with another effect."
        if adapt
        else f"While it only judged pushes a session grew by at most {account.growth[0]:.0f} MB, in"
        f" {account.growth[1]:.1f} min."
    )
    paragraph(
        f"{account.minutes:.1f} simulated minutes, {len(account.sessions)} sessions, {account.pushes} pushes"
        f" recorded, {account.lost} lost. Of {account.commands} commands the fastest asked a joint for"
        f" {100 * account.joint_speed:.0f} % of its largest speed, the finger for"
        f" {100 * account.tip_speed:.0f} %. {growth}"
    )
    bad = account.lost or max(account.joint_speed, account.tip_speed) > 1.001
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()

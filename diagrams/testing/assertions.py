"""What a scripted test of a cell may ask for; where it is not so, the message has the numbers."""

from collections.abc import Sequence

import numpy as np

from slipmap.diagrams.hardware.guard import GuardSettings
from slipmap.diagrams.loops.exploration_run import ExplorationRun
from slipmap.diagrams.loops.pregrasp_loop import PregraspRun
from slipmap.diagrams.systems.model_monitor import LEVEL, Watch
from slipmap.diagrams.testing.command_log import CommandLog
from slipmap.models.inference.diagnosis.results import Diagnosis
from slipmap.models.inference.results import Identification
from slipmap.models.robots import ARM_JOINTS, SPEED_LIMITS

_ROUNDING = 1e-3  # stamps have microseconds, of which 5 ms are 5000


def assert_predicts(run: ExplorationRun | Identification, within: float, role: str = "heldout") -> None:
    """Held-out pushes end where they were predicted.

    Args:
        within: largest mean distance of the cells at the end of each push, m.
        role: `heldout`, or `fit` for the pushes that were learned from.
    """
    learned = _learned(run)
    errors = learned.errors(role)
    assert len(errors), f"no push has the role {role}, so nothing was predicted; ask for checks"
    assert errors.max() <= within, (
        f"a push ended {1e3 * errors.max():.1f} mm from where it was predicted, {1e3 * within:.1f} mm are"
        f" allowed\n{_pushes(learned)}"
    )


def assert_better_than_uniform(run: ExplorationRun | Identification, times: float = 1.0) -> None:
    """Held-out pushes are predicted better, on average, than by the uniform object.

    Args:
        times: by which factor the error must be smaller.
    """
    learned = _learned(run)
    own, uniform = learned.errors("heldout").mean(), learned.errors("heldout", "uniform_add").mean()
    assert times * own < uniform, (
        f"predictions are off by {1e3 * own:.1f} mm, those of a uniform object by {1e3 * uniform:.1f} mm\n"
        f"{_pushes(learned)}"
    )


def assert_alarm(watch: Watch) -> None:
    """The monitor gave an alarm: the object does not move as the model says."""
    assert any(push.alarm for push in watch.judged), f"no alarm\n{_judged(watch)}"


def assert_quiet(watch: Watch, judged: int = 3) -> None:
    """The monitor gave no alarm, though it had as many pushes to judge as an alarm takes, or as are asked."""
    assert len(watch.judged) >= judged, (
        f"only {len(watch.judged)} pushes were judged, {judged} are asked for; make more\n{_judged(watch)}"
    )
    assert not any(push.alarm for push in watch.judged), f"the monitor gave an alarm\n{_judged(watch)}"


def assert_names(diagnosis: Diagnosis, effect: str) -> None:
    """The diagnosis names an effect, alone or among those that the pushes cannot tell apart."""
    named = diagnosis.verdict in ("effect", "ambiguous") and effect in diagnosis.effects
    assert named, f"{effect} is not named; verdict {diagnosis.verdict}: {diagnosis.sentence}"


def assert_adopts(run: ExplorationRun, effect: str) -> None:
    """The robot gave its model an effect on the way, and kept it to the end."""
    assert run.repair is not None, "the run was not to adapt; ask for adapt=True"
    said = "\n".join(f"push {found.pushes}: {found.verdict}, {found.action}" for found in run.repair.findings)
    assert effect in run.repair.effects, f"{effect} is not in the model at the end\n{said or 'no diagnosis'}"


def assert_held(run: PregraspRun) -> None:
    """The gripper holds the object in the end."""
    assert run.held, f"the object is not held after {len(run.pushes)} pushes to the edge: {run.reason}"


def assert_limits_kept(commands: Sequence[CommandLog], guard: GuardSettings) -> None:
    """No command asked a joint, or the finger, for more speed than it may have.

    Args:
        commands: of a `Cell`.
        guard: of the scenario; `tip_speed` is used.
    """
    assert any(len(log.times) > 1 for log in commands), "no commands were heard"
    for log in commands:
        if len(log.times) < 2:
            continue
        share = np.abs(log.joint_speeds) / SPEED_LIMITS
        row, joint = np.unravel_index(share.argmax(), share.shape)
        assert share[row, joint] <= 1.0 + _ROUNDING, (
            f"{ARM_JOINTS[joint]} was asked for {share[row, joint]:.2f} times its largest speed at"
            f" {log.times[row]:.3f} s of the sender's clock"
        )
        fastest = log.tip_speeds.argmax()
        assert log.tip_speeds[fastest] <= guard.tip_speed * (1.0 + _ROUNDING), (
            f"the finger was asked for {log.tip_speeds[fastest]:.2f} m/s at {log.times[fastest]:.3f} s of the"
            f" sender's clock, {guard.tip_speed:g} m/s are allowed"
        )


def _learned(run: ExplorationRun | Identification) -> Identification:
    return run.identification if isinstance(run, ExplorationRun) else run


def _pushes(learned: Identification) -> str:
    return "\n".join(
        f"{push.trial} ({push.role}): {1e3 * push.final_add:.1f} mm; uniform {1e3 * push.uniform_add:.1f} mm,"
        f" hypotheses spread by {1e3 * push.spread:.1f} mm"
        for push in learned.pushes
    )


def _judged(watch: Watch) -> str:
    rows = [
        f"push {push.trial + 1}: misfit {push.misfit:.1f}, evidence {push.evidence:.3g} of {1 / LEVEL:.0f}"
        for push in watch.judged
    ]
    return "\n".join(rows) or "no push was judged"

"""How a robot repaired its model during a run, in words."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from slipmap.diagrams.systems.diagnosis import FAILED, TRIED, Finding, Repair
from slipmap.diagrams.systems.model_monitor import Judged, Watch

_DID = {
    "adopts": "From then on, the model included {effects}.",
    "keeps": "The model kept {effects}.",
    "drops": "The added effect was dropped: it did not explain the pushes after all.",
    "pushes on": "The robot made another push to find out.",
    "goes on without": "The robot continued with the model it had.",
}


def repair_story(repair: Repair, watch: Watch) -> list[str]:
    """Sentences on each diagnosis and the action taken, then on how much the error fell."""
    if not repair.findings:
        return ["The model was not repaired: no push gave cause for a diagnosis."]
    said = [_finding(finding) for finding in repair.findings]
    said += _widening(repair.findings[-1], watch.judged)
    after = [push for push in watch.judged if set(repair.effects) <= set(push.effects)]
    before = [push for push in watch.judged if push not in after]
    if repair.effects and before and after:
        said.append(
            f"Before, {_errors(before)}; with {_names(repair.effects)}, {_errors(after)}. Each push was"
            " predicted before it was made."
        )
    return said


def _finding(finding: Finding) -> str:
    did = _DID[finding.action].format(effects=_names(finding.effects))
    looked = "" if finding.verdict in (FAILED, TRIED) else ", diagnosis"
    said = f"After push {finding.pushes}{looked}: {finding.sentence} {did}"
    return f"{said} The next pushes were chosen to tell {finding.telling}." if finding.telling else said


def _widening(last: Finding, judged: Sequence[Judged]) -> list[str]:
    """How much wider intervals became, where the run ended with surprises that no effect explains."""
    before = [push.allowed for push in judged if push.trial < last.pushes]
    after = [push.allowed for push in judged if push.trial >= last.pushes]
    if last.verdict != "unknown" or last.action != "goes on without" or not before or not after:
        return []
    return [
        "What no effect explains counts as model error: pushes now count as surprising beyond"
        f" {1e3 * median(after):.1f} mm (median); before, beyond"
        f" {1e3 * before[-1]:.1f} mm."
    ]


def _errors(judged: Sequence[Judged]) -> str:
    off = 1e3 * median(push.error for push in judged)
    share = median(push.error / push.moved for push in judged)
    count = f"{len(judged)} push{'es' * (len(judged) > 1)}"
    return f"{count} ended {off:.1f} mm off (median), {100 * share:.0f} % of how far they moved the object"


def _names(effects: Sequence[str]) -> str:
    return " and ".join(effects)

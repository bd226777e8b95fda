"""An audit: probes that name, and pushes that price."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slipmap.diagrams.application.audit import engines, probes
from slipmap.diagrams.application.audit.defects import Measure, measures
from slipmap.diagrams.application.audit.engine import Subject
from slipmap.diagrams.application.audit.prices import (
    COUNT,
    Explained,
    Pushed,
    StandardPushes,
    explain,
    laws,
    push_all,
    standard_pushes,
)
from slipmap.models.effects.library import LIBRARY
from slipmap.models.files import BadInput
from slipmap.models.progress import Progress, silent


@dataclass(frozen=True, eq=False)
class Audit:
    """What was found of one engine."""

    name: str
    version: str  # name and version of its package, empty for a user's engine
    dt: float  # s
    answers: probes.Answers
    measures: tuple[Measure, ...]  # of all that can be named
    pushed: Pushed
    pushed_half: Pushed  # at half the time step
    # effects that lower the price, the maps being held, the best first
    explained: tuple[Explained, ...]
    standard: StandardPushes

    @property
    def defects(self) -> list[Measure]:
        """What is named."""
        return [measure for measure in self.measures if measure.named]

    @property
    def remedies(self) -> list[str]:
        """What to set to be nearer to Coulomb's law."""
        found = (engines.remedy(self.name, defect.key) for defect in self.defects)
        return sorted(filter(None, found), key=lambda remedy: remedy.startswith("against"))

    def to_json(self) -> dict[str, Any]:
        """The same as JSON knows it."""
        return {
            "engine": self.name,
            "version": self.version,
            "step": self.dt,
            "price_mm": 1e3 * self.pushed.price,
            "worst_mm": 1e3 * self.pushed.errors.max(),
            "price_at_half_step_mm": 1e3 * self.pushed_half.price,
            "defects": [defect.key for defect in self.defects],
            "measures": [
                {
                    "key": measure.key, "title": measure.title, "value": measure.value,
                    "uncertainty": measure.uncertainty, "tolerance": measure.tolerance,
                    "unit": measure.unit, "named": measure.named,
                    "sentence": measure.sentence, "effect": measure.effect,
                }
                for measure in self.measures
            ],
            "remedies": self.remedies,
            "friction_by_direction": [
                {"degrees": float(np.degrees(way)), "over_coulomb": size, "leaning_degrees": lean}
                for way, size, lean in zip(
                    np.arctan2(*self.answers.direction.T[::-1]),
                    np.linalg.norm(self.answers.friction, axis=1),
                    np.degrees(probes.leaned(self.answers)),
                    strict=True,
                )
            ],
            "explained": [
                {
                    "effect": one.effect.name, "price_mm": 1e3 * one.price,
                    "parameters": {
                        p.name: value for p, value in zip(one.effect.parameters, one.values, strict=True)
                    },
                }
                for one in self.explained
            ],
        }  # fmt: skip


def audit(
    subject: Subject, standard: StandardPushes | None = None, progress: Progress | None = None
) -> Audit:
    """Audit one engine.

    Raises:
        BadInput: it fails.
    """
    report, standard = progress or silent, standard or standard_pushes()
    half = subject.halved()
    answers = []
    for one in (subject, half):
        stage = f"{subject.name}, probes at {1e3 * one.dt:g} ms"
        answers.append(probes.ask(one, _counter(report, stage, probes.COUNT)))
    found = measures(answers[0], answers[1], subject.dt)
    pushed, pushed_half = (
        push_all(one, standard, _counter(report, f"{subject.name}, pushes at {1e3 * one.dt:g} ms", COUNT))
        for one in (subject, half)
    )
    tried = laws(LIBRARY) if pushed.price > _NOTHING else []
    explained = []
    for number, effect in enumerate(tried):
        report(f"{subject.name}, what explains it: {effect.name}", number, len(tried))
        explained.append(explain(pushed, standard, effect))
    better = [one for one in explained if one.price < _LOWER * pushed.price]
    better.sort(key=lambda one: one.price)
    return Audit(
        subject.name, engines.version(subject.name), subject.dt, answers[0], tuple(found), pushed,
        pushed_half, tuple(better), standard,
    )  # fmt: skip


def prices_beside(
    audited: Sequence[str], standard: StandardPushes, progress: Progress | None = None
) -> Mapping[str, float]:
    """Prices, m, of the built-in engines that are installed, as they are set by default; of others than those
    that are audited."""
    report, result = progress or silent, {}
    for name in engines.installed():
        if name not in audited:
            counter = _counter(report, f"{name}, pushes to compare with", COUNT)
            try:
                result[name] = push_all(engines.find_engine(name), standard, counter).price
            except BadInput:  # one that does not run here is none to compare with
                continue
    return result


_LOWER = 0.9  # of the price, at most, that an effect leaves
_NOTHING = 5e-4  # m; a price below needs no explanation


def _counter(report: Progress, stage: str, total: int) -> probes.Report:
    report(stage, 0, total)
    return lambda done: report(stage, done, total)

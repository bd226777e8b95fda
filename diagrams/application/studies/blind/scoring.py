"""Scores of diagnoses: what was hidden and what was diagnosed."""

import textwrap
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slipmap.diagrams.application.campaigns.trials import exact_range
from slipmap.diagrams.application.studies.blind.generator import Truth
from slipmap.diagrams.application.terminal import WIDTH
from slipmap.models.files import plain
from slipmap.models.inference.diagnosis.results import VERDICTS

COLUMNS = {
    "adequate": "adequate",
    "right": "effect: the true one",
    "near": "effect: one similar to the true one",
    "wrong": "effect: another one",
    "in set": "ambiguous, including the true one",
    "not in": "ambiguous, without the true one",
    "unknown": "unknown",
    "undec.": "undecided",
}
"""Diagnoses judged by the truth: column heading and meaning."""

_ALARMS = ("right", "near", "wrong", "in set", "not in", "unknown")
_OUTSIDE = " *"  # mark of effects that are not in the library


@dataclass(frozen=True)
class Rate:
    """A count out of a total."""

    what: str
    hits: int
    of: int

    @property
    def share(self) -> float:
        """Share of hits; NaN if the total is 0."""
        return self.hits / self.of if self.of else float("nan")

    @property
    def range(self) -> tuple[float, float]:
        """95 % range of the true share (Clopper and Pearson)."""
        return exact_range(self.hits, self.of)

    def text(self) -> str:
        """Count, share and range in words."""
        low, high = self.range
        return f"{self.hits} of {self.of}, {self.share:.0%} ({low:.0%} to {high:.0%})"


@dataclass(frozen=True)
class Score:
    """Score of many diagnoses."""

    confusion: dict[str, dict[str, int]]  # counts by truth and diagnosis (keys of `COLUMNS`)
    named: dict[str, dict[str, int]]  # how often each effect was named as the only one, by truth
    rates: tuple[Rate, ...]  # the main figures
    cases: tuple[dict[str, Any], ...]  # one entry per dataset
    failed: dict[str, str]  # datasets without a diagnosis, and why

    def to_json(self) -> dict[str, Any]:
        """The score as JSON."""
        rates = [vars(rate) | {"share": rate.share, "range": rate.range} for rate in self.rates]
        return plain({**vars(self), "columns": COLUMNS, "rates": rates})

    def text(self) -> str:
        """The score for a terminal of 80 columns."""
        widths = [21, 3, *(max(len(name), 4) for name in COLUMNS)]
        head, *rows = (_row(row, widths) for row in self._rows())
        lines = [head, "─" * (sum(widths) + len(widths) - 1), *rows]
        lines.append("")
        rates = self._counted()
        wide = max((len(rate.what) for rate in rates), default=0)
        lines += [f"{rate.what:<{wide}}  {rate.text()}" for rate in rates]
        lines += ["", *(line for remark in self._remarks() for line in textwrap.wrap(remark, WIDTH))]
        return "\n".join(line.rstrip() for line in lines).rstrip() + "\n"

    def markdown(self) -> str:
        """The same as Markdown."""
        head, *rows = ("| " + " | ".join(row) + " |" for row in self._rows())
        lines = [head, "| --- |" + " ---: |" * (1 + len(COLUMNS)), *rows]
        lines += ["", "| figure | value (95 % range) |", "| --- | --- |"]
        lines += [f"| {rate.what} | {rate.text()} |" for rate in self._counted()]
        lines += ["", *(f"- {remark}" for remark in self._remarks())]
        return "\n".join(lines).rstrip() + "\n"

    def _counted(self) -> list[Rate]:
        """Rates with a nonzero total."""
        return [rate for rate in self.rates if rate.of]

    def _rows(self) -> list[list[str]]:
        """The headings, then the counts for each truth."""
        rows = [["hidden", "n", *COLUMNS]]
        for truth, counts in self.confusion.items():
            numbers = [str(counts[column]) if counts[column] else "·" for column in COLUMNS]
            rows.append([truth, str(sum(counts.values())), *numbers])
        return rows

    def _remarks(self) -> list[str]:
        remarks = []
        if any(label.endswith(_OUTSIDE) for label in self.confusion):
            remarks.append("*: not in slipmap's library; `unknown` is the correct verdict")
        remarks.append(
            "; ".join(f"{name} = {meaning}" for name, meaning in COLUMNS.items() if name != meaning)
        )
        gains = [
            [case["heldout_misfit_before"], case["heldout_misfit_after"]]
            for case in self.cases
            if case["said"] == "right"
        ]
        gains = [gain for gain in gains if None not in gain]
        if gains:
            before, after = np.median(gains, axis=0)
            remarks.append(
                f"held-out misfit where the true effect was named: {before:.3g} → {after:.3g} (medians)"
            )
        seconds = [case["seconds"] for case in self.cases if case["seconds"] is not None]
        if seconds:
            remarks.append(f"a diagnosis takes {np.median(seconds):.0f} s (median)")
        remarks += [f"no diagnosis of {name}: {why}" for name, why in self.failed.items()]
        return remarks


def score(pairs: Iterable[tuple[Truth, Mapping[str, Any]]], failed: Mapping[str, str] | None = None) -> Score:
    """Compare the hidden truths with the diagnoses.

    Args:
        pairs: truth and the JSON document of the diagnosis, with the keys verdict, effect, effects,
            parameters, p_value, heldout_misfit_before, heldout_misfit_after and seconds.
        failed: why a dataset has no diagnosis, by name.

    Raises:
        ValueError: a verdict that is not in `VERDICTS`.
    """
    cases = [_case(truth, result) for truth, result in pairs]
    # Datasets without an effect first, then effects of the library, then others.
    cases.sort(key=lambda case: (case["truth"] != "none", case["outside"], case["truth"], case["name"]))
    confusion: dict[str, dict[str, int]] = {}
    named: dict[str, Counter[str]] = {}
    for case in cases:
        label = case["truth"] + (_OUTSIDE if case["outside"] else "")
        confusion.setdefault(label, dict.fromkeys(COLUMNS, 0))[case["said"]] += 1
        if case["verdict"] == "effect":
            named.setdefault(label, Counter())[str(case["effect"])] += 1
    return Score(
        confusion=confusion,
        named={label: dict(count) for label, count in named.items()},
        rates=_rates(cases),
        cases=tuple(cases),
        failed=dict(failed or {}),
    )


def said(truth: Truth, verdict: str, effect: str | None, effects: Sequence[str]) -> str:
    """The column, one of `COLUMNS`, of a diagnosis.

    Raises:
        ValueError: a verdict that is not in `VERDICTS`.
    """
    if verdict not in VERDICTS:
        raise ValueError(f"{truth.name}: verdict {verdict!r} is not one of {', '.join(VERDICTS)}")
    if verdict == "effect":
        if truth.effect is not None and effect == truth.effect:
            return "right"
        return "near" if effect in truth.resembles else "wrong"
    if verdict == "ambiguous":
        # For an effect outside the library, a look-alike in the set is the best possible answer.
        wanted = {truth.effect} if truth.in_library else set(truth.resembles)
        return "in set" if wanted & set(effects) else "not in"
    return "undec." if verdict == "undecided" else verdict


def _case(truth: Truth, result: Mapping[str, Any]) -> dict[str, Any]:
    verdict, effect, effects = result["verdict"], result.get("effect"), list(result.get("effects") or [])
    return {
        "name": truth.name,
        "truth": truth.effect or "none",
        "outside": truth.effect is not None and not truth.in_library,
        "strength": truth.strength,
        "final_change_mm": truth.final_change_mm["mean"],
        "verdict": verdict,
        "effect": effect,
        "effects": effects,
        "said": said(truth, verdict, effect, effects),
        "true_parameters": truth.parameters,
        "parameters": result.get("parameters"),
        "p_value": result.get("p_value"),
        "heldout_misfit_before": result.get("heldout_misfit_before"),
        "heldout_misfit_after": result.get("heldout_misfit_after"),
        "seconds": result.get("seconds"),
    }


def _rates(cases: Sequence[Mapping[str, Any]]) -> tuple[Rate, ...]:
    def rate(what: str, among: list[Mapping[str, Any]], *hits: str) -> Rate:
        return Rate(what, sum(case["said"] in hits for case in among), len(among))

    none = [case for case in cases if case["truth"] == "none"]
    inside = [case for case in cases if case["truth"] != "none" and not case["outside"]]
    outside = [case for case in cases if case["outside"]]
    clear = [case for case in inside if case["strength"] == "clear"]
    weak = [case for case in inside if case["strength"] == "weak"]
    effect = [case for case in cases if case["verdict"] == "effect"]
    ambiguous = [case for case in inside if case["verdict"] == "ambiguous"]
    return (
        rate("false alarms where nothing is hidden", none, *_ALARMS),
        rate("named effects that are right", effect, "right"),
        rate("ambiguous sets that hold the truth", ambiguous, "in set"),
        rate("clear effects named rightly", clear, "right"),
        rate("clear effects named or in the set", clear, "right", "in set"),
        rate("clear effects missed (adequate)", clear, "adequate"),
        rate("weak effects named or in the set", weak, "right", "in set"),
        rate("weak effects missed (adequate)", weak, "adequate"),
        rate("effects outside the library: unknown", outside, "unknown"),
        rate("effects outside: named a look-alike", outside, "near", "in set"),
        rate("effects outside: named another", outside, "wrong", "not in"),
    )  # fmt: skip


def _row(cells: Sequence[str], widths: Sequence[int]) -> str:
    first, *others = cells
    numbers = [f"{cell:>{width}}" for cell, width in zip(others, widths[1:], strict=True)]
    return " ".join([f"{first:<{widths[0]}}", *numbers])

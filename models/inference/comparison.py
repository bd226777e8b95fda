"""Compare a belief with measured pushes: how large its errors are, relative to what, and where it fails.

`compare` is the entry point. One `Comparison` is about one model; reports show two of them over the same
pushes (before and after an effect was added) side by side.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np

from slipmap.models.blas import one_blas_thread
from slipmap.models.effects.effect import Effect
from slipmap.models.effects.registry import effects_given
from slipmap.models.files import plain
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.diagnosis.locked import with_locked
from slipmap.models.inference.diagnosis.results import JointIdentification
from slipmap.models.inference.diagnosis.several import check_together, fit_together
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.friction_laws import laws_without
from slipmap.models.inference.hypotheses import unexplained_share
from slipmap.models.inference.identification import identify
from slipmap.models.inference.observations import observe_all
from slipmap.models.inference.prediction import Prediction, check_same_object, predict_observations
from slipmap.models.inference.push_errors import Errors, NoiseFloor, noise_floor
from slipmap.models.inference.residual_structure import (
    LEVEL,
    Correlations,
    Pattern,
    corrected,
    correlations,
    delay_pattern,
    factor_patterns,
)
from slipmap.models.inference.residuals import Residuals, force_residuals, motion_residuals
from slipmap.models.inference.results import Identification, belief_of
from slipmap.models.inference.sign_flips import smallest_p
from slipmap.models.measurements import PushDataset
from slipmap.models.measurements.push_dataset import Setup, check_dataset_given, check_distinct
from slipmap.models.progress import Progress, about, silent
from slipmap.models.settings import check_whole


@dataclass(frozen=True)
class Totals:
    """Means over the pushes of one role; NaN where no push has the number."""

    pushes: int  # number of pushes
    model: Errors  # means of all errors
    uniform: Errors  # the same for a uniform object
    resting: Errors  # the same for an object that does not move
    median_add: float  # median final ADD of the model, m

    def to_json(self) -> dict[str, object]:
        """All numbers."""
        errors = {"model": self.model, "uniform": self.uniform, "no_motion": self.resting}
        return {"pushes": self.pushes, "median_final_add": self.median_add, **errors}


def _push_to_json(push: Prediction) -> dict[str, object]:
    names = ("trial", "role", "ends_only", "spread", "surprising", "excess")
    errors = {"model": push.errors, "uniform": push.uniform, "no_motion": push.resting}
    return {name: getattr(push, name) for name in names} | errors


@dataclass(frozen=True, eq=False)
class Comparison:
    """Result of `compare`."""

    label: str  # what the model is called, such as `base` or `with table_tilt`
    dataset: str  # name of the pushes
    learnt_from: str  # name of the dataset that taught the belief
    pushes: tuple[Prediction, ...]  # one by one
    totals: dict[str, Totals]  # by role; a role without pushes is missing
    floor: NoiseFloor | None  # error below which models cannot be told apart, or None where unknown
    motion: Residuals | None  # residual velocities, or None where nothing moves
    force: Residuals | None  # residual forces, or None where force was not measured
    structure: tuple[Pattern, ...]  # what residuals depend on, the most certain first
    correlations: Correlations | None  # over time, or None where too few pushes were measured along the way
    seed: int  # of every random draw
    # share of the distance moved by which the best maps miss the pushes that taught the belief, where that is
    # the largest share that is tried, so that it may be larger; else None
    unexplained: float | None = None

    def __repr__(self) -> str:
        errors = ", ".join(
            f"{1e3 * totals.model.final_add:.2f} mm over {totals.pushes} {role} pushes"
            for role, totals in self.totals.items()
        )
        return f"Comparison({self.label!r} on dataset {self.dataset!r}; mean ADD at the end {errors})"

    @property
    def significant(self) -> tuple[Pattern, ...]:
        """Patterns that chance is unlikely to explain."""
        return tuple(pattern for pattern in self.structure if pattern.significant)

    @property
    def testable(self) -> bool:
        """Whether there are enough pushes for any pattern to be significant."""
        return any(smallest_p(pattern.pushes) * len(self.structure) < LEVEL for pattern in self.structure)

    @property
    def mostly_unseen(self) -> bool:
        """Whether most of these pushes were not used to learn the belief.

        Errors of the maps, common to the unseen pushes, can then show as patterns (see `residual_structure`).
        """
        if self.learnt_from != self.dataset:
            return True
        unseen = sum(push.role == "heldout" for push in self.pushes)
        return 2 * unseen > len(self.pushes)

    def to_json(self) -> dict[str, object]:
        """The machine-readable result; lengths in m, angles in rad, forces in N."""
        names = ("label", "dataset", "learnt_from", "totals", "structure", "correlations", "seed")
        document = {name: getattr(self, name) for name in names} | {
            "noise_floor": self.floor,
            "pushes": [_push_to_json(push) for push in self.pushes],
            "structure_testable": self.testable,
        }
        return plain(document)


@one_blas_thread()
def compare(
    dataset: PushDataset,
    belief: Belief | Identification | None = None,
    *,
    seed: int = 0,
    label: str = "model",
    progress: Progress | None = None,
) -> Comparison:
    """Compare a belief with every push of a dataset.

    Args:
        dataset: pushes of the object that the belief is about.
        belief: what was learned, from this or another dataset; predictions that came with it, where nothing
            in the dataset has changed since, are not made again; if None, `identify` learns it first.
        seed: of every random draw (sign flips, pairings, draws of noise).
        label: what to call the model.
        progress: called with (stage, done, total).

    Raises:
        BeliefError: the dataset has a different finger or object.
        DatasetError: there is neither a belief nor a push to learn one from.
        TypeError, ValueError: something other than a dataset and a belief; a seed that is no whole number.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=1, heldout=2)
        >>> belief = slipmap.identify(dataset, hypotheses=2, friction_laws=False).belief
        >>> comparison = slipmap.compare(dataset, belief)
        >>> comparison.label, len(comparison.pushes)
        ('model', 3)
    """
    check_dataset_given(dataset)
    check_whole("seed", seed, 0)
    noise = sensor_noise(dataset)
    pushes: tuple[Prediction, ...] | None = None
    if belief is None:
        belief = identify(dataset, seed=seed, progress=progress)
    learned, belief = belief, belief_of(belief)
    if isinstance(learned, Identification) and learned.dataset is not None:
        # A fingerprint does not tell: it is of the files, and stays when something is replaced in a dataset.
        pushes = learned.pushes if _measured(learned.dataset) == _measured(dataset) else None
    if pushes is None:
        check_same_object(belief, dataset)
        belief = belief.on(dataset.table)
        every = observe_all(dataset)
        pushes = predict_observations(belief, every, noise, progress)
    report = progress or silent
    grid = belief.grid
    observations, motions = [push.observation for push in pushes], [push.motion for push in pushes]

    rng = np.random.default_rng(seed)
    report("looking for patterns", 0, 4)
    motion = motion_residuals(observations, motions, grid, belief.finger_radius)
    force = force_residuals(observations, motions, grid, belief.finger_radius)
    floor = noise_floor(observations, noise, grid)
    ends_only = all(push.ends_only for push in pushes)
    report("looking for patterns", 1, 4)
    patterns = factor_patterns(motion, "motion", rng, whole_pushes=ends_only) if motion is not None else []
    report("looking for patterns", 2, 4)
    patterns += factor_patterns(force, "force", rng) if force is not None else []
    delay = delay_pattern(observations, motions, grid, rng)
    patterns += [] if delay is None else [delay]
    report("looking for patterns", 3, 4)
    together = correlations(observations, motions, grid, rng)
    report("looking for patterns", 4, 4)
    roles = [role for role in ("fit", "heldout") if any(push.role == role for push in pushes)]
    return Comparison(
        label=label,
        dataset=dataset.name,
        learnt_from=belief.dataset,
        pushes=pushes,
        totals={role: totals([p for p in pushes if p.role == role]) for role in roles},
        floor=floor,
        motion=motion,
        force=force,
        structure=corrected(patterns),
        correlations=together,
        seed=seed,
        unexplained=unexplained_share(belief.settings),
    )


@one_blas_thread()
def compare_with_effects(
    dataset: PushDataset, effects: Sequence[Effect | str], *, seed: int = 0, progress: Progress | None = None
) -> tuple[Comparison, Comparison]:
    """Compare the models without and with some effects, learned from the same pushes, with all pushes.

    The model without lacks them among its laws of friction too.

    Args:
        effects: to add to the model; those of the library may be given by name.

    Raises:
        DatasetError, EffectError: as `identify`.

    Example:
        >>> import slipmap
        >>> from slipmap.models.inference.comparison import compare_with_effects
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=1)
        >>> [comparison.label for comparison in compare_with_effects(dataset, ["table_tilt"])]
        ['without effects', 'with table_tilt']
    """
    added = effects_given(effects)
    report = progress or silent
    models = {"without effects": (), "with " + " and ".join(effect.name for effect in added): added}
    learned = {
        label: identify(
            dataset, given, seed=seed, progress=about(label, report), friction_laws=laws_without(added)
        )
        for label, given in models.items()
    }
    before, after = (
        compare(dataset, own, seed=seed, label=label, progress=progress) for label, own in learned.items()
    )
    return before, after


@dataclass(frozen=True, eq=False)
class JointComparison:
    """Result of `compare_together`."""

    datasets: tuple[tuple[Comparison, ...], ...]  # of each: one model, or those without and with effects
    fitted: JointIdentification | None  # the model with effects; None where there are none

    @property
    def recurring(self) -> tuple[tuple[Pattern, tuple[str, ...]], ...]:
        """Patterns that are significant in two datasets or more with the last model, each as it is where it
        is clearest, and the names of these datasets; the most frequent first."""
        found: dict[tuple[str, str], list[tuple[Pattern, str]]] = {}
        for *_, last in self.datasets:
            for pattern in last.significant:
                found.setdefault((pattern.quantity, pattern.factor), []).append((pattern, last.dataset))
        shared = [
            (min((pattern for pattern, _ in own), key=lambda p: p.p_corrected), tuple(n for _, n in own))
            for own in found.values()
            if len(own) > 1
        ]
        return tuple(sorted(shared, key=lambda pair: (-len(pair[1]), pair[0].p_corrected)))

    def to_json(self) -> dict[str, object]:
        """The machine-readable result; each dataset as `Comparison.to_json` says."""
        recurring = [
            {"quantity": pattern.quantity, "factor": pattern.factor, "datasets": names}
            for pattern, names in self.recurring
        ]
        return plain({"datasets": self.datasets, "recurring": recurring, "fitted": self.fitted})


@one_blas_thread()
def compare_together(
    datasets: Sequence[PushDataset],
    effects: Sequence[Effect | str] = (),
    *,
    apart: Collection[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> JointComparison:
    """Compare models of several objects, each with all pushes of its own dataset.

    Args:
        datasets: two or more, each of one object.
        effects: to add to the model, shared as in `fit_together`; those of the library may be given by name.
            Without any, the model is what `identify` learns.
        apart: owners of effects that the datasets do not share, as in `fit_together`.

    Raises:
        DatasetError, EffectError, RolloutError, ValueError: as `fit_together`; also two datasets that share
            a push.
        TypeError: something other than datasets.

    Example:
        >>> import dataclasses
        >>> import slipmap
        >>> from slipmap.models.inference.comparison import compare_together
        >>> first, again = (slipmap.simulated_hammer(seed=s, fit=2, heldout=1)[0] for s in (1, 2))
        >>> found = compare_together([first, dataclasses.replace(again, name="again")])
        >>> [one.dataset for (one,) in found.datasets]
        ['hammer', 'again']
    """
    check_together(datasets, apart)
    check_distinct(datasets)
    report = progress or silent
    fitted = fit_together(datasets, effects, apart=apart, seed=seed, progress=progress) if effects else None
    laws = laws_without(effects_given(effects))
    found = []
    for k, dataset in enumerate(datasets):
        own = about(dataset.name, report)
        pushes = dataset if fitted is None else with_locked(dataset, fitted.datasets[k].locked)
        plain = identify(pushes, seed=seed, progress=own, friction_laws=laws)
        models = {"model" if fitted is None else "without effects": plain}
        if fitted is not None:
            models["with " + " and ".join(fitted.effects)] = fitted.learned[k]
        found.append(
            tuple(
                compare(pushes, learned, seed=seed, label=label, progress=own)
                for label, learned in models.items()
            )
        )
    return JointComparison(tuple(found), fitted)


def _measured(dataset: PushDataset) -> list[object]:
    """All that predictions depend on; arrays are equal only if they are the very same."""
    setup = [getattr(dataset, field.name) for field in fields(Setup)]
    return [
        *setup,
        *((trial.name, trial.role, trial.order, trial.channels, trial.tip_angle) for trial in dataset.trials),
    ]


def totals(pushes: Sequence[Prediction]) -> Totals:
    """Means over some pushes, at least one."""
    return Totals(
        pushes=len(pushes),
        model=_mean([push.errors for push in pushes]),
        uniform=_mean([push.uniform for push in pushes]),
        resting=_mean([push.resting for push in pushes]),
        median_add=float(np.median([push.errors.final_add for push in pushes])),
    )


def _mean(errors: Sequence[Errors]) -> Errors:
    """Mean of each number over the pushes that have it."""

    def mean(name: str) -> float:
        known = [value for error in errors if np.isfinite(value := getattr(error, name))]
        return float(np.mean(known)) if known else float("nan")

    return Errors(**{name: mean(name) for name in asdict(errors[0])})

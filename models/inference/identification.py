"""From pushes to a belief: multiple starts, Gauss-Newton on whole trajectories, randomised refits.

Every entry point uses the same estimator. `identify` learns the maps, and effects too where some are given;
`fit` learns both with and without effects; a diagnosis judges its answer by the same two. The model without
effects lacks them among its laws of friction too.

The strict likelihood of the diagnosis finds where effects act (`EffectSearch`). It trusts every row of
force, and is confident about a total mass that a 2 % error of the force model shifts by a third; whatever is
proportional to mass, such as a tilt, shifts with it. So the sizes of effects also come from the forgiving
likelihood, with its prior centred where the strict one led.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slipmap.models.blas import one_blas_thread
from slipmap.models.effects.effect import Effect, EffectError
from slipmap.models.effects.registry import effects_given
from slipmap.models.inference.belief import END_ERRORS, OUTLINE_ERROR, Belief
from slipmap.models.inference.cross_validation import end_errors, leave_out
from slipmap.models.inference.error_model import sensor_noise
from slipmap.models.inference.friction_laws import LAW_EFFECTS, laws_without
from slipmap.models.inference.gauss_newton import fit as fit_maps, of_dataset
from slipmap.models.inference.identifiability import Informed, effect_quantities, quantities
from slipmap.models.inference.likelihood import Likelihood, LikelihoodSettings
from slipmap.models.inference.mixture import (
    EffectsGiven,
    bold_compared,
    explain,
    mixed_belief,
    on_a_slope,
    shared_out,
    weighed,
    with_fine_fits,
)
from slipmap.models.inference.observations import Observation, observe_all, to_learn_from
from slipmap.models.inference.prediction import predict_observations
from slipmap.models.inference.prior import STRUCTURES, MapPrior, PriorSettings, slider_for
from slipmap.models.inference.results import Identification
from slipmap.models.measurements import DatasetError, PushDataset
from slipmap.models.measurements.push_dataset import check_dataset_given
from slipmap.models.measurements.rim_checks import beyond_table
from slipmap.models.measurements.trial_checks import contradicted_by_contact
from slipmap.models.physics.cell_grid import CellGrid
from slipmap.models.physics.rollout import Maps, RolloutError
from slipmap.models.progress import Progress, about, part_of, silent
from slipmap.models.settings import check_whole

if TYPE_CHECKING:
    from slipmap.models.inference.diagnosis.fitting import Fitted

METHODS = ("gauss-newton", "paper")

MOST_CELLS = 800
"""Most cells to learn with."""

_REFUTED = "the pushes contradict the known maps"


@one_blas_thread()
def identify(
    dataset: PushDataset,
    effects: Sequence[Effect | str] = (),
    *,
    method: str = "gauss-newton",
    hypotheses: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
    prior_settings: PriorSettings | None = None,
    friction_laws: bool | Collection[str] = True,
    rivals: Sequence[Sequence[Effect | str]] = (),
) -> Identification:
    """Learn the maps of mass and friction from a dataset's `fit` pushes; judge them on all pushes.

    Args:
        dataset: measured pushes.
        effects: to add to the model and learn with the maps; those of the library may be given by name.
        method: `gauss-newton`, or `paper` for Algorithm 1 as printed, which does not support effects.
        hypotheses: K, at least 2.
        seed: of every random draw.
        progress: called with (stage, done, total).
        prior_settings: the prior of the maps; if None, each of `STRUCTURES` is used, weighted by how well it
            explains the pushes.
        friction_laws: whether to include laws of friction besides the plain one, weighted in the same way
            (see `friction_laws`), or names of the effects that they may consist of (`load_transfer`,
            `impulse_friction`); more laws take longer. The method `paper` has only the plain one.
        rivals: other sets of effects that may be there instead of `effects`, such as `[["tether"]]`, weighted
            in the same way: each hypothesis has one set, and the other effects at their nulls. A rival that
            cannot be fitted, or explains the pushes far worse, gets none. Shares are in
            `belief.settings["rivals"]`; what is said of an effect is said of the hypotheses that have it.

    Returns:
        The result: `belief` with the masses (K, n), kg, and frictions (K, n) of the n cells in `belief.maps`,
        and the probabilities (K,); the predictions of all pushes, whose distances from the measured ends
        `errors(role)` returns, (B,) m; and `quantities` with their units and 90 % intervals.

    Raises:
        DatasetError: there is no push to fit, or the model with the effects cannot be fitted.
        ValueError: an unknown method or law, effects with `paper`, too few hypotheses, or a seed that is not
            a whole number of at least 0.
        EffectError: an unknown effect, or a formula that cannot be used.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=1)
        >>> result = slipmap.identify(dataset, hypotheses=4, friction_laws=False)
        >>> len(result.belief), result.errors("heldout").shape
        (4, (1,))
    """
    added = effects_given(effects)
    others = _rivals_given(rivals, added)
    check_method(method, [*added, *others])
    laws = _laws_given(friction_laws)
    check_request(dataset, hypotheses, seed)
    off, _ = beyond_table(dataset, dataset.trials)
    if off is not None and not any(off in warning for warning in dataset.warnings):  # not read from a file
        logging.getLogger("slipmap.measurements").warning("dataset %s: %s", dataset.name, off)
    started = time.perf_counter()
    report = progress or silent
    report("preparing pushes", 0, 1)
    observations = observe_all(dataset)
    report("preparing pushes", 1, 1)
    if method == "paper":
        return _by_algorithm_1(dataset, observations, hypotheses, seed, report, started)
    fitted = to_learn_from([observation for observation in observations if observation.role == "fit"])
    few = with_fewer_cells(dataset)

    found: Fitted | None = None
    beside: list[Fitted | None] = []
    sets = [wanted for wanted in (added, *others) if wanted]
    if sets:
        from slipmap.models.inference.diagnosis.refits import EffectSearch

        count = 1 + len(sets)
        parts = (part_of(partial(report, "finding effects"), place, count) for place in range(count))

        @cache
        def search() -> EffectSearch:
            return EffectSearch.of(few, fitted, next(parts))

        def with_effects(wanted: Sequence[Effect]) -> Fitted | None:
            return search().find(wanted, np.random.default_rng(seed), next(parts)) if wanted else None

        found = with_effects(added)
        for other in others:
            with suppress(DatasetError):
                beside.append(with_effects(other))
    return learn(
        dataset, observations, found, hypotheses=hypotheses, seed=seed, report=report,
        prior_settings=prior_settings, laws=laws, rivals=beside, started=started,
    )  # fmt: skip


@one_blas_thread()
def learn(
    dataset: PushDataset,
    observations: Sequence[Observation],
    found: Fitted | EffectsGiven | None,
    *,
    hypotheses: int = 20,
    seed: int = 0,
    report: Progress = silent,
    prior_settings: PriorSettings | None = None,
    laws: Collection[str] = LAW_EFFECTS,
    rivals: Sequence[Fitted | EffectsGiven | None] = (),
    started: float | None = None,
) -> Identification:
    """Do the work of `identify` on prepared pushes, with the effects of an earlier fit as starting point.

    Args:
        observations: all its pushes; those with the role `fit` are fitted.
        found: the model with effects, as fitted before; None for the model without.
        hypotheses, seed, prior_settings: as in `identify`.
        laws: names of the effects that laws of friction besides the plain one may consist of.
        rivals: like `found`, other models that may be right instead.
        started: reading of `time.perf_counter` when the work began; now if None.
    """
    started = time.perf_counter() if started is None else started
    fitted = to_learn_from([observation for observation in observations if observation.role == "fit"])
    models = [None if one is None else on_a_slope(one, dataset) for one in (found, *rivals)]
    found = models[0]
    given = [effect for one in models if one is not None for effect in one.effects]
    # A force that contradicts the contact is useless unless an effect explains it.
    contradicted = not any(effect.only_force for effect in given) and contradicted_by_contact(
        dataset, dataset.fit_trials
    )
    if contradicted:
        fitted = [observation.without_forces for observation in fitted]

    few = with_fewer_cells(dataset)
    fitting = partial(report, "fitting")
    with of_dataset(dataset.name, () if found is None else found.effects):
        explained = partial(explain, few, fitted, prior_settings, laws=laws)
        every = explained(part_of(fitting, 0, len(models)), found)
        for place, other in enumerate(models[1:], 1):
            with suppress(RolloutError, np.linalg.LinAlgError):
                every = [*every, *explained(part_of(fitting, place, len(models)), other)]
        every = shared_out(every) if rivals else every
        share_of_known = None
        if dataset.known is not None and not every[0].given:
            free, own = replace(few, known=None), partial(report, "fitting free maps")
            compared = (every[0], *explain(free, fitted, STRUCTURES["smooth"], own, laws=()))
            share_of_known = weighed(compared)[0].share
        every = with_fine_fits(every, dataset.noise)
        learned = mixed_belief(few, every, hypotheses, seed, report)
        noise = sensor_noise(dataset)
        left_out = leave_out(*every[0].drawn_from[-1])
        told = {**learned.settings, END_ERRORS: end_errors(left_out, noise), OUTLINE_ERROR: noise.outline}
        belief = spread_out(replace(learned, settings=told), dataset)
        predictions = predict_observations(belief, observations, noise, report)
    leading = [one for one in every if one.given == every[0].given]
    informed = [Informed(one.likelihood, one.best, one.share) for one in leading]
    facts = quantities(
        learned, informed, contradicted=contradicted, bold=bold_compared(leading), heaviest=dataset.heaviest
    )
    if share_of_known == 0.0:  # wrong maps, or an effect that would otherwise bend them
        facts = tuple(replace(fact, shown=False, reason=_REFUTED) for fact in facts)
    for effect in learned.effects:
        one = next((one for one in every if effect in one.given), None)
        if one is not None:  # the effects of laws are not told
            facts = (*facts, *effect_quantities(learned, effect, one.likelihood, one.best))
    shares = belief.settings["friction_laws"]
    return Identification(
        belief, predictions, facts, time.perf_counter() - started, shares, share_of_known, dataset=dataset
    )  # fmt: skip


def _by_algorithm_1(
    dataset: PushDataset,
    observations: Sequence[Observation],
    hypotheses: int,
    seed: int,
    report: Progress,
    started: float,
) -> Identification:
    from slipmap.models.inference.paper_method import identify_by_algorithm_1

    belief = identify_by_algorithm_1(dataset, hypotheses=hypotheses, seed=seed, progress=report)
    prior = MapPrior(slider_for(dataset), PriorSettings(), dataset.mass)
    fitted = [observation for observation in observations if observation.role == "fit"]
    likelihood = Likelihood(prior, fitted, dataset.noise, LikelihoodSettings())
    predictions = predict_observations(belief, observations, sensor_noise(dataset), report)
    found = fit_maps(likelihood, np.array([prior.start(0.35)]))
    facts = quantities(belief, [Informed(likelihood, found, 1.0)], heaviest=dataset.heaviest)
    return Identification(belief, predictions, facts, time.perf_counter() - started, dataset=dataset)


def fit(
    dataset: PushDataset,
    effects: Sequence[Effect | str],
    *,
    hypotheses: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
) -> Identification:
    """Learn the maps with some effects, and without them, from the same pushes, as `slipmap fit` does.

    Args:
        dataset, effects, hypotheses, seed, progress: as in `identify`.

    Returns:
        What was learned with the effects; its `without_effects` is what `identify` learns without them, also
        among its laws of friction.

    Raises:
        DatasetError, ValueError, EffectError: as `identify`.

    Example:
        >>> import slipmap
        >>> dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=1)
        >>> result = slipmap.fit(dataset, ["table_tilt"], hypotheses=2)
        >>> sorted(result.effect_estimates["table_tilt"])
        ['down_x', 'down_y']
    """
    result = identify(dataset, effects, hypotheses=hypotheses, seed=seed, progress=progress)
    own = about("without effects", progress or silent)
    laws = laws_without(effects_given(effects))
    plain = identify(dataset, hypotheses=hypotheses, seed=seed, progress=own, friction_laws=laws)
    return replace(result, without_effects=plain)


def _laws_given(friction_laws: bool | Collection[str]) -> tuple[str, ...]:
    """What laws may consist of, checked.

    Raises:
        ValueError: neither a bool nor a collection of their names.
    """
    if isinstance(friction_laws, bool | np.bool_):
        return LAW_EFFECTS if friction_laws else ()
    if isinstance(friction_laws, Collection) and not isinstance(friction_laws, str | bytes):
        given = tuple(friction_laws)
        if all(name in LAW_EFFECTS for name in given):
            return given
    names = ", ".join(LAW_EFFECTS)
    raise ValueError(
        f"friction_laws must be True, False or a list with names of {names}, got {friction_laws!r}"
    )


def _rivals_given(
    rivals: Sequence[Sequence[Effect | str]], effects: Sequence[Effect]
) -> list[tuple[Effect, ...]]:
    """Sets of effects that differ from `effects` and from each other, checked like these.

    Raises:
        EffectError: as `effects_given`, or something other than a list of lists.
    """
    if isinstance(rivals, str) or not isinstance(rivals, Sequence):
        raise EffectError(f"rivals must be a list of lists of effects, such as [['tether']], got {rivals!r}")
    for rival in rivals:
        if isinstance(rival, str | Effect):
            raise EffectError(f"each of rivals must be a list of effects: write [[{rival!r}]]")
    different = {frozenset(effect.name for effect in effects): tuple(effects)}
    for given in map(effects_given, rivals):
        different.setdefault(frozenset(effect.name for effect in given), given)
    return list(different.values())[1:]


def check_method(method: str, effects: Sequence[object]) -> None:
    """Raise ValueError for an unknown method, or effects with one that does not support them."""
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; choose one of {', '.join(METHODS)}")
    if effects and method == "paper":
        raise ValueError("the method paper does not support effects; use gauss-newton")


def check_draws(hypotheses: int, seed: int) -> None:
    """Raise ValueError if there are too few hypotheses for a belief, or a seed that no file could record."""
    check_whole("hypotheses", hypotheses, 2)
    check_whole("seed", seed, 0)


def check_request(dataset: PushDataset, hypotheses: int, seed: int) -> None:
    """Refuse a request from which no belief can be learned.

    Raises:
        DatasetError: there is no push to fit.
        TypeError: something other than a dataset.
        ValueError: too few hypotheses, or a seed that is not a whole number.
    """
    check_dataset_given(dataset)
    check_draws(hypotheses, seed)
    if not dataset.fit_trials:
        raise DatasetError(
            f"dataset {dataset.name} has no push with the role fit; set the role of at least one push to fit"
        )


# Objects of many cells.


def with_fewer_cells(dataset: PushDataset) -> PushDataset:
    """The dataset with square blocks of cells merged, if there are more than `MOST_CELLS` of them.

    The time of a fit grows with the number of cells, but a few hundred resolve what the prior lets maps vary.
    Unchanged where the maps are known by cell.
    """
    known = dataset.known
    by_cell = known is not None and (known.mass is not None or known.friction is not None)
    if len(dataset.grid) <= MOST_CELLS or by_cell:
        return dataset
    return replace(dataset, grid=_merged(dataset.grid)[0])


def spread_out(belief: Belief, dataset: PushDataset) -> Belief:
    """A belief about merged cells, as one about the dataset's own: those that were merged share their mass
    evenly and their friction."""
    if len(belief.grid) == len(dataset.grid):
        return belief
    place, maps = _merged(dataset.grid)[1], belief.maps
    mass = (maps.mass / np.bincount(place))[:, place]
    spread = Maps(mass, maps.mu[:, place], maps.mu_finger, maps.effects)
    return replace(belief, grid=dataset.grid, maps=spread)


@lru_cache(maxsize=16)
def _merged(grid: CellGrid) -> tuple[CellGrid, NDArray[np.int64]]:
    """The cells merged to at most `MOST_CELLS` blocks, and the block (n,) that each belongs to."""
    corner = grid.centers.min(axis=0) - 0.5 * grid.width
    side, place = 1, np.arange(len(grid))
    while place.max() >= MOST_CELLS:
        side *= 2
        blocks = np.floor((grid.centers - corner) / (side * grid.width) + 1e-6)
        place = np.unique(blocks, axis=0, return_inverse=True)[1].reshape(-1)
    members = np.bincount(place)
    centers = np.column_stack([np.bincount(place, axis) / members for axis in grid.centers.T])
    return CellGrid(centers, side * grid.width, grid.exterior, grid.holes, members), place

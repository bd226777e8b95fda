"""Which quantities the pushes determine, which they leave open, and why.

The Gauss-Newton Hessian H of the data's cost, in coordinates where the prior is N(0, 1), measures the
information in the data: a quantity with gradient c over the coordinates has prior variance cᵀc and posterior
variance cᵀ(H + I)⁻¹c. It counts as shown where less than a quarter of the prior's variance (half its width)
is left, where it was measured beforehand, or, if it is the parameter of an effect, where its 90 % interval
excludes the value at which the effect vanishes.

Slow pushes reveal no more of mass than the load of each cell, mass times friction. With the prior of
friction this already narrows total mass and moment of inertia, and the centre of mass because friction is
expected to vary less than mass, though nothing was learned of inertia. So these must also keep less than a
quarter of the variance that known loads leave: the squared length of the part of c orthogonal to the
gradients of all loads, in a prior that knows neither mass nor maps.

Hypotheses scatter by what pushes disagree about. Where the model is good, the fits allow for larger errors
than that, and the prior draws an object unlike most others further off than its hypotheses scatter. So the
interval of a quantity that is shown follows from the scatter or from the posterior variance, averaged over
the explanations, whichever is wider. (What is left open may be far from linear; there hypotheses alone tell.)

Pushes show sums over the whole base, such as the centre and the arm of friction. What lies in a third of it
also follows from how maps vary. Structures with one scale of variation are sure that a nearly empty third
holds more than it does, and the evidence does not single out the structure that is right. So a share counts
as shown only if every explanation in the belief shows it, and if structures that vary strongly were compared;
and its interval, shown or not, is as wide as the explanation that leaves most open makes it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from slipmap.models.effects.effect import Effect, columns_of
from slipmap.models.geometry import rotated
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.gauss_newton import Fits
from slipmap.models.inference.hypotheses import MODEL_ERRORS
from slipmap.models.inference.likelihood import Likelihood
from slipmap.models.inference.prior import MapPrior
from slipmap.models.inference.results import Quantity
from slipmap.models.inference.summaries import interval
from slipmap.models.measurements.trial_checks import SELDOM_LESS, SELDOM_MORE
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps, Slider

SHOWN_SHARE = 0.25
"""A quantity that keeps less than this share of its prior variance counts as shown."""

_KEPT = 0.04
"""How far the logarithm of the total mass may be off what was weighed: two standard deviations of that."""

_FEW_WIDTHS = 1.25
"""Widths of a cell; an object whose friction arm is shorter rests on too few cells to follow its base. The
arm of three by three equal cells is 1.07 widths, that of four by four 1.53."""

_SMALL_BASE = 0.5
"""Share of the whole footprint's arm below which an object rests on a part of it."""


_CENTRE = ("centre of friction, x", "centre of friction, y")
_ARM = "friction arm (mean distance from its centre)"
_TOO_HEAVY = "hardly any object of this size is so heavy: is the force in N?"
_TOO_SLOW = "motion is so slow that friction outweighs inertia; coasting or a fast start would show it"
_TOO_LITTLE_INERTIA = "inertia shows too little of it; coasting or faster starts would show more"
_TOO_ALIKE = "so few pushes with such errors do not show how strongly the maps vary"


class Informed(NamedTuple):
    """A fit, with its share of the belief."""

    likelihood: Likelihood
    fit: Fits  # one hypothesis
    share: float


@dataclass(frozen=True)
class _Measure:
    """A quantity as a function of maps: `log` if it is compared as a ratio, `share` if it lies in 0 to 1,
    `given` if the dataset states it, so that it is never left open, `inertial` if loads do not count as
    showing it."""

    name: str
    unit: str
    of: Callable[[Maps], FloatArray]
    log: bool
    shown: str
    open: str
    share: bool = False
    given: bool = False
    inertial: bool = False


@dataclass(frozen=True)
class _Seen:
    """Properties of the fitted pushes that the reasons refer to."""

    turned: float  # largest rotation between start and end, rad
    coasted: bool  # whether the object of any push was already sliding at the start
    touched: bool  # whether there was a finger
    forces: bool  # whether there are forces that count
    recorded: bool  # whether there are any
    missed: float  # model error α
    place: FloatArray  # (2,) mean place of the object, world, m
    contradicted: bool = False  # whether forces were left out because they contradict the contact

    @classmethod
    def of(cls, likelihood: Likelihood) -> _Seen:
        observations = likelihood.observations
        pushes = [observation.push for observation in observations]
        poses = np.concatenate([o.poses for o in observations])
        middle = likelihood.prior.slider.grid.centers.mean(axis=0)
        turns = [abs(o.poses[-1, 2] - o.push.start_pose[2]) for o in observations]
        return cls(
            max(turns),
            any(push.start_twist.any() for push in pushes),
            any(np.isfinite(push.tip).any() for push in pushes),
            any(observation.sliding.any() for observation in observations),
            any(len(observation.forces) for observation in observations),
            likelihood.settings.model_error,
            (poses[:, :2] + rotated(middle, poses[:, 2])).mean(axis=0),
        )

    def of_friction(self, with_effects: bool) -> tuple[str, str]:
        """Why the total friction is shown, and why it is left open."""
        if self.forces:
            return "force in steady sliding", "too few forces were measured in steady pushing"
        inertia = f"friction against inertia{' or the effects' if with_effects else ''}"
        missing = "no measured force is of steady pushing" if self.recorded else "no force was measured"
        if self.contradicted:
            missing = "the measured force contradicts the contact and was left out"
            more = "correct its frame, or learn with the effect force_frame"
        else:
            more = (
                "in slow motion along a given finger path, scaling all friction leaves every pose unchanged"
            )
        return "stopping distances" if self.coasted else inertia, f"{missing}: {more}"

    @property
    def slow(self) -> str:
        """Why what inertia shows is left open."""
        similar = "the object slid freely for too short a time, or too similarly each time"
        return self.unless_missed(similar if self.coasted else _TOO_SLOW)

    @property
    def no_turn(self) -> str:
        """Why the friction arm is left open."""
        hardly = self.turned < np.radians(10.0)
        return self.unless_missed(
            "the object hardly turns in these pushes"
            if hardly
            else "all pushes turn the object too similarly"
        )

    @property
    def no_contact(self) -> str:
        """Why the friction at the finger is left open."""
        sticking = "the contact sticks in all pushes, or slides the same way in all"
        return sticking if self.touched else "no finger touches the object"

    def unless_missed(self, reason: str) -> str:
        """The reason why something is left open, or a large model error as the reason where there is one."""
        if self.missed < 0.04:
            return reason
        more = " or more" if self.missed == MODEL_ERRORS[-1] else ""
        return f"the model error itself is {100 * self.missed:.0f} %{more} of the distance moved"


def quantities(
    belief: Belief,
    informed: Sequence[Informed],
    *,
    contradicted: bool = False,
    bold: bool = True,
    heaviest: float = np.inf,
) -> tuple[Quantity, ...]:
    """Value, 90 % interval and verdict for each quantity.

    Args:
        informed: fits that they come from; the first decides what is shown, of shares all of them.
        contradicted: whether a measured force was left out because it contradicts the contact.
        bold: whether maps that vary strongly were compared with the others.
        heaviest: mass that no object of this size exceeds, kg.
    """
    likelihood = informed[0].likelihood
    prior = likelihood.prior
    seen = replace(_Seen.of(likelihood), contradicted=contradicted)
    measures = _measures(prior.slider, seen, prior.mass is not None)
    of_belief = _measures(belief.slider, seen, prior.mass is not None)  # whose maps carry more effects
    variances = [_variances(measures, one) for one in informed]
    shares = np.array([one.share for one in informed])
    left = np.array([after for _, after in variances])
    averages = shares @ left / shares.sum()
    left_by_loads = _left_by_loads(measures, prior, informed[0].fit.z)
    if prior.known is not None:
        free = MapPrior(prior.slider, prior.settings, prior.mass)
        open_widths = [g @ g for g in _gradients(measures, free, np.zeros(free.size))]
    masses = belief.maps.mass.sum(axis=1)
    too_heavy = prior.mass is None and interval(masses, belief.probability, log=True)[0] > heaviest
    results: list[Quantity] = []
    by_inertia = False  # whether inertia shows any quantity
    for place, measure in enumerate(measures):
        if prior.known is not None and variances[0][0][place] < SHOWN_SHARE * open_widths[place]:
            measure = replace(
                measure, given=True, shown=measure.shown if measure.given else "known beforehand"
            )
        deciding = variances if measure.share else variances[:1]
        narrowed = bool(
            measure.given or all(after[place] < SHOWN_SHARE * before[place] for before, after in deciding)
        )
        by_loads = (
            measure.inertial
            and not measure.given
            and variances[0][1][place] >= SHOWN_SHARE * left_by_loads[place]
        )
        alike = measure.share and not measure.given and not bold
        shown = narrowed and not by_loads and not alike
        values = of_belief[place].of(belief.maps)
        variance = left[:, place].max() if measure.share else averages[place]
        widened = narrowed or measure.share
        more = _beyond(values, belief.probability, float(variance), measure.log) if widened else 0.0
        value, low, high = interval(values, belief.probability, log=measure.log, more=more)
        if measure.share:
            low, high = max(low, 0.0), min(high, 1.0)
        if measure.name == "total mass" and prior.mass and abs(np.log(value / prior.mass)) > _KEPT:
            shown = False
            who = "the pushes" if prior.known is None else "the known map and the pushes"
            measure = replace(measure, open=f"{prior.mass:.3g} kg were weighed, but {who} contradict this")
        if too_heavy and measure.inertial and measure.log:  # these are in proportion to the mass
            shown = False
            measure = replace(measure, open=_TOO_HEAVY)
        reason = measure.shown if shown else _TOO_ALIKE if narrowed and alike else measure.open
        if measure.name == "total friction" and shown and not measure.given and prior.mass:
            share = value / (prior.mass * prior.slider.gravity)
            if not SELDOM_LESS < share < SELDOM_MORE:
                reason += f", but {share:.2g} times the weight: are force and mass in N and kg, and right?"
        if measure.name == "total friction" and shown and too_heavy:
            reason += f", but {_TOO_HEAVY}"
        if shown and measure.share and not measure.given:
            reason = _basis_of_shares({one.name for one in results if one.shown}) or reason
        by_inertia |= bool(shown and measure.inertial and not measure.given)
        results.append(Quantity(measure.name, measure.unit, value, low, high, shown, reason))
    if by_inertia:  # so motion is not too slow for others
        results = [replace(r, reason=_TOO_LITTLE_INERTIA) if r.reason == _TOO_SLOW else r for r in results]
    return tuple(results)


def _basis_of_shares(shown: set[str]) -> str:
    """Of the quantities from which shares follow, those that are shown; empty if none is."""
    parts = [part for part, names in (("centre", set(_CENTRE)), ("arm", {_ARM})) if names <= shown]
    return f"{' and '.join(parts)} of friction" if parts else ""


def _variances(measures: Sequence[_Measure], one: Informed) -> tuple[list[float], list[float]]:
    """Variances of the quantities (of logarithms where they are compared as ratios) before and after the
    pushes."""
    prior = one.likelihood.prior
    posterior = np.linalg.inv(one.fit.hessian[0] + np.eye(prior.size))
    gradients = _gradients(measures, prior, one.fit.z[0])
    return [float(g @ g) for g in gradients], [float(g @ posterior @ g) for g in gradients]


def _left_by_loads(measures: Sequence[_Measure], prior: MapPrior, z: FloatArray) -> list[float]:
    """Variances of the quantities if the load of every cell were known, but no maps beforehand.

    They are those of maps at coordinates (1, d).
    """
    free = MapPrior(prior.slider, prior.settings, prior.mass)
    near = free.near(prior.maps(z))
    of_loads = free.columns(free.maps(near))[0, : len(prior.slider.grid)].T
    gradients = np.array(_gradients(measures, free, near[0])).T
    left = gradients - of_loads @ np.linalg.lstsq(of_loads, gradients, rcond=None)[0]
    return [float(variance) for variance in (left**2).sum(axis=0)]


def _beyond(values: FloatArray, probability: FloatArray, variance: float, log: bool = False) -> float:
    """Standard deviation that the scatter of values, or of their logarithms, lacks to a variance."""
    x = np.log(np.maximum(values, 1e-300)) if log else values
    return float(np.sqrt(max(variance - float(probability @ (x - probability @ x) ** 2), 0.0)))


def effect_quantities(
    belief: Belief, effect: Effect, likelihood: Likelihood, information: Fits
) -> list[Quantity]:
    """The same for the parameters of an effect, if it is present; clipped to the allowed range.

    Intervals follow from the hypotheses or from the curvature of the cost, whichever is wider: where the
    model is good, the pushes disagree by less than the likelihood allows for.
    """
    prior = likelihood.prior
    own = columns_of(effect, prior.slider.effects)
    deviations = prior.effect_deviations(information.hessian[0])[own]
    left = np.diagonal(np.linalg.inv(information.hessian[0] + np.eye(prior.size)))[prior.plain :][own]
    carried, probability = belief.parameters_of(effect.name)
    facts = []
    for parameter, values, share, deviation in zip(
        effect.parameters, carried.T, left, deviations, strict=True
    ):
        more = _beyond(values, probability, float(deviation) ** 2)
        middle, low, high = interval(values, probability, more=more)
        clear = parameter.null is not None and not low <= parameter.null <= high
        if share < SHOWN_SHARE:
            reason = "the pushes determine it, if the effect is present"
        elif clear:
            reason = f"not {parameter.null:g}, where the effect vanishes; how large is less certain"
        else:
            reason = "left open by these pushes; the prior decides"
        shown = bool(share < SHOWN_SHARE or clear)
        low, high = max(low, float(parameter.low)), min(high, float(parameter.high))
        name = f"{effect.name}: {parameter.name}"
        facts.append(Quantity(name, parameter.unit, middle, low, high, shown, reason))
    return facts


def _gradients(measures: Sequence[_Measure], prior: MapPrior, z: FloatArray) -> list[FloatArray]:
    """Gradients of quantities by central differences over the coordinates; maps alone are cheap."""
    difference = 1e-4
    shifts = difference * np.eye(prior.size)
    maps = prior.maps(np.concatenate([z + shifts, z - shifts]))
    every = [np.log(measure.of(maps)) if measure.log else measure.of(maps) for measure in measures]
    return [(values[: prior.size] - values[prior.size :]) / (2.0 * difference) for values in every]


def friction_arms(grid: CellGrid, maps: Maps) -> FloatArray:
    """(K,) mean distance of friction from its centre, m."""
    load = maps.mass * maps.mu
    share = load / load.sum(axis=1, keepdims=True)
    from_center = grid.centers - (share @ grid.centers)[:, None]
    return np.asarray((share * np.hypot(*from_center.transpose(2, 0, 1))).sum(axis=1))


def coarse_cells(belief: Belief) -> str | None:
    """Evidence, as a clause, that cells are too coarse for the base that carries the object; else None."""
    grid, width = belief.grid, belief.grid.width
    arm = float(belief.probability @ friction_arms(grid, belief.maps))
    whole = np.hypot(*(grid.centers - grid.centers.mean(axis=0)).T).mean()
    if arm > min(_FEW_WIDTHS * width, _SMALL_BASE * whole):
        return None
    return (
        f"friction acts only {1e3 * arm:.1f} mm from its centre on average, but cells are"
        f" {1e3 * width:.1f} mm wide; give finer ones as `object.cells` of dataset.yaml (`width` and"
        f" `centers`), as Python's `slipmap.cells_from_polygon(outline, width={width / 2.0:.2g})` makes them"
    )


def _measures(slider: Slider, seen: _Seen, weighed: bool) -> list[_Measure]:
    """What is told of an object, with the reason for either verdict; `weighed` if its mass is given."""
    centers = slider.grid.centers
    g = slider.gravity

    def load(maps: Maps) -> FloatArray:
        return maps.mass * maps.mu * g

    def total(maps: Maps) -> FloatArray:
        result, first = load(maps).sum(axis=1), 0
        for effect in slider.effects:
            last = first + len(effect.parameters)
            result, first = result * effect.level(seen.place, maps.effects[:, first:last]), last
        return result

    def share(maps: Maps) -> FloatArray:
        f = load(maps)
        return f / f.sum(axis=1, keepdims=True)

    def middle(maps: Maps) -> FloatArray:
        return share(maps) @ centers

    def com(maps: Maps) -> FloatArray:
        return slider.grid.center_of(maps.mass)

    def inertia(maps: Maps) -> FloatArray:
        m, sx, sy, second = slider.inertia(maps.mass).T
        return second - (sx**2 + sy**2) / m

    no_axis = seen.unless_missed("no push turns the object in a way that shows this coordinate")
    slow = seen.slow
    measures = [
        _Measure("total friction", "N", total, True, *seen.of_friction(bool(slider.effects))),
        *(
            _Measure(name, "m", _column(middle, i), False, "how the object turns when pushed", no_axis)
            for i, name in enumerate(_CENTRE)
        ),
        _Measure(_ARM, "m", partial(friction_arms, slider.grid),
                 True, "how much the object turns", seen.no_turn),
        _Measure("total mass", "kg", lambda m: m.mass.sum(axis=1), True,
                 "weighed beforehand" if weighed else "acceleration under a measured force", slow,
                 given=weighed, inertial=True),
        *(
            _Measure(f"centre of mass, {axis}", "m", _column(com, i), False,
                     "inertia follows the mass", slow, inertial=True)
            for i, axis in enumerate("xy")
        ),
        _Measure("moment of inertia about the centre of mass", "kg m²", inertia, True,
                 "rotation that speeds up or coasts", slow, inertial=True),
        _Measure("finger friction", "-", lambda m: m.mu_finger, True,
                 "the contact slides in some pushes", seen.no_contact),
    ]  # fmt: skip
    for name, parts in thirds_of(slider.grid):
        measures.append(
            _Measure(f"share of mass × friction, {name}", "-", _sum(share, parts), False,
                     "how the object turns when pushed",
                     "other distributions turn the object the same way", True)
        )  # fmt: skip
    return measures


def _column(of: Callable[[Maps], FloatArray], index: int) -> Callable[[Maps], FloatArray]:
    return lambda maps: of(maps)[:, index]


def _sum(of: Callable[[Maps], FloatArray], parts: FloatArray) -> Callable[[Maps], FloatArray]:
    return lambda maps: of(maps) @ parts


def thirds_of(grid: CellGrid) -> list[tuple[str, FloatArray]]:
    """Thirds of the footprint along its longer side by name, and how much of each cell lies in them (n,).

    Of ten columns, three and a third lie in each. None for fewer than six cells.
    """
    if len(grid) < 6:
        return []
    axis = int(np.argmax(np.ptp(grid.centers, axis=0)))
    place, half = grid.centers[:, axis], 0.5 * grid.width
    borders = np.linspace(place.min() - half, place.max() + half, 4)
    thirds = []
    for name, left, right in zip(("low", "middle", "high"), borders, borders[1:], strict=False):
        inside = np.minimum(place + half, right) - np.maximum(place - half, left)
        thirds.append((f"{name} {'xy'[axis]} third", np.clip(inside / grid.width, 0.0, 1.0)))
    return [(name, parts) for name, parts in thirds if parts.any()]

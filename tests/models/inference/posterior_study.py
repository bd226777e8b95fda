"""Randomised refits against long chains on the same posterior: the page docs/lab/posterior.md.

    python -m tests.models.inference.posterior_study wrench hammer [--page PAGE.md]

An object that slides exactly as the model says is explored with five pushes. Its likeliest explanation is a
prior of the maps and a likelihood, so a posterior. It is sampled twice: by the randomised refits that beliefs
consist of, and by Hamiltonian Monte Carlo (Neal, 2011): exact in the limit, but hundreds of times slower.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from slipmap.diagrams.application.campaigns.worlds import as_dataset, explored
from slipmap.models.inference.gauss_newton import Fits
from slipmap.models.inference.hypotheses import draws, refits
from slipmap.models.inference.likelihood import Likelihood
from slipmap.models.inference.mixture import explain, with_fine_fits
from slipmap.models.inference.observations import observe_all
from slipmap.models.objects.benchmark_objects import benchmark_object
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.models.physics.rollout import Maps, RolloutError
from tests.diagrams.application.campaigns.model_as_plant import ModelWorld

SEED = 80
CHAINS, ITERATIONS, DROPPED = 12, 60, 20
HYPOTHESES = 60
_ACCEPTED = 0.7  # share of proposals, which the step size is adapted to while iterations are dropped
_LENGTH, _MOST_STEPS = 1.0, 60  # of a trajectory, in standard deviations and in steps


class Point(NamedTuple):
    """Where K chains are."""

    q: FloatArray  # (K, d + 3 B) coordinates of the maps, and starts in standard deviations
    energy: FloatArray  # (K,)
    slope: FloatArray  # (K, d + 3 B)


class Posterior:
    """-log p(maps, starts | pushes) up to a constant, with its derivatives."""

    def __init__(self, likelihood: Likelihood) -> None:
        self.likelihood, self.size = likelihood, likelihood.prior.size
        self.pushes = len(likelihood.observations)

    def at(self, q: FloatArray) -> Point:
        """The posterior of K points (K, d + 3 B)."""
        K, B, sigma = len(q), self.pushes, self.likelihood.start_sigma
        z, starts = q[:, : self.size], q[:, self.size :].reshape(K, B, 3)
        found = self.likelihood.linearise(z, starts * sigma, np.ones(K), np.ones((K, B)))
        # The gradient of the normal equations is that with the starts eliminated.
        back = found.coupling @ found.start_gain @ found.start_gradient[..., None]
        slope = found.gradient + back.sum(axis=0)[..., 0] + z
        by_start = (found.start_gradient.swapaxes(0, 1) * sigma).reshape(K, -1)
        energy = found.cost.sum(axis=1) + 0.5 * (z**2).sum(axis=1)
        return Point(q, energy, np.concatenate([slope, by_start], axis=1))

    def scale(self, best: Fits) -> FloatArray:
        """(d + 3 B, d + 3 B) a root of the posterior's covariance at the best fit."""
        d, sigma = self.size, self.likelihood.start_sigma
        found = self.likelihood.linearise(best.z, best.offsets, np.ones(1), np.ones((1, self.pushes)))
        hessian = np.eye(d + 3 * self.pushes)
        hessian[:d, :d] += found.hessian[0]
        for push in range(self.pushes):
            own = slice(d + 3 * push, d + 3 * push + 3)
            beside = found.coupling[push, 0] * sigma[push]
            gain = found.start_gain[push, 0] / np.outer(sigma[push], sigma[push])
            hessian[own, own] = np.linalg.inv(gain)
            hessian[:d, own], hessian[own, :d] = beside, beside.T
            hessian[:d, :d] += beside @ gain @ beside.T
        values, vectors = np.linalg.eigh(hessian)
        return vectors / np.sqrt(np.maximum(values, 0.5))


def sampled(posterior: Posterior, best: Fits, first: FloatArray, rng: Generator) -> FloatArray:
    """(N, K, d) maps' coordinates of K chains that begin at `first` (K, d + 3 B)."""
    root, here = posterior.scale(best), posterior.at(first)
    step, kept = 0.03, []
    for iteration in range(ITERATIONS):
        momentum = rng.standard_normal(here.q.shape)
        there, later = here, momentum
        steps = int(np.clip(rng.uniform(0.5, 1.0) * _LENGTH / step, 5, _MOST_STEPS))
        try:
            for _ in range(steps):
                later = later - 0.5 * step * there.slope @ root
                there = posterior.at(there.q + step * later @ root.T)
                later = later - 0.5 * step * there.slope @ root
            change = here.energy - there.energy + 0.5 * ((momentum**2).sum(axis=1) - (later**2).sum(axis=1))
            taken = np.log(rng.uniform(size=len(change))) < np.nan_to_num(change, nan=-np.inf)
        except RolloutError:  # one chain went where nothing can be computed
            taken = np.zeros(len(first), dtype=bool)
        here = Point(
            np.where(taken[:, None], there.q, here.q),
            np.where(taken, there.energy, here.energy),
            np.where(taken[:, None], there.slope, here.slope),
        )
        if iteration < DROPPED:
            step *= np.exp(0.5 * (taken.mean() - _ACCEPTED))
        kept.append(here.q[:, : posterior.size])
        print(f"  {iteration + 1} of {ITERATIONS}: {steps} steps of {step:.3f}, {taken.mean():.0%} accepted")
    return np.array(kept[DROPPED:])


def quantities(maps: Maps, grid: CellGrid) -> dict[str, FloatArray]:
    """What pushes show of K maps, each (K,), in mm, N and kg."""
    load = maps.mass * maps.mu
    of_mass, of_load = (w @ grid.centers / w.sum(axis=1, keepdims=True) for w in (maps.mass, load))
    away = np.linalg.norm(grid.centers - of_load[:, None], axis=-1)
    return {
        "centre of mass, x": 1e3 * of_mass[:, 0],
        "centre of mass, y": 1e3 * of_mass[:, 1],
        "centre of friction, x": 1e3 * of_load[:, 0],
        "centre of friction, y": 1e3 * of_load[:, 1],
        "friction arm": 1e3 * (load * away).sum(axis=1) / load.sum(axis=1),
        "total friction": 9.81 * load.sum(axis=1),
        "total mass": maps.mass.sum(axis=1),
    }


def rows(name: str) -> list[str]:
    """The study's rows for one object."""
    rng, world = np.random.default_rng([SEED, 1]), ModelWorld(benchmark_object(name))
    true, dataset = world.true_object, as_dataset(world, explored(world, SEED)[1])
    every = explain(dataset, observe_all(dataset), None, _silent, laws=())
    one = with_fine_fits(every, dataset.noise)[0]
    likelihood, best = one.drawn_from[-1]
    print(f"{name}: {one.structure}, {likelihood.prior.size} coordinates", flush=True)
    usual = draws(one.drawn_from, HYPOTHESES, rng, keep_best=False)
    refitted, weight = refits(one.drawn_from, usual._replace(strength=np.ones(HYPOTHESES)), _silent)
    starts = (best.offsets / likelihood.start_sigma).reshape(1, -1)
    first = np.repeat(np.concatenate([best.z, starts], axis=1), CHAINS, axis=0)
    chains = sampled(Posterior(likelihood), best, first, rng)
    by_chains = quantities(likelihood.prior.maps(np.concatenate(chains)), true.grid)
    by_refits, truth = quantities(refitted, true.grid), quantities(true.maps, true.grid)
    told = []
    for what, values in by_chains.items():
        mean = float(weight @ by_refits[what])
        spread = float(np.sqrt(weight @ (by_refits[what] - mean) ** 2))
        of_chain = values.reshape(chains.shape[:2])
        mixed = float(np.sqrt(1.0 + of_chain.mean(axis=0).var(ddof=1) / of_chain.var(axis=0, ddof=1).mean()))
        digits = 3 if what.startswith("total") else 1
        cells = [f"{truth[what][0]:.{digits}f}"] + [
            f"{middle:.{digits}f} ± {deviation:.{digits}f}"
            for middle, deviation in ((mean, spread), (values.mean(), values.std()))
        ]
        told.append(f"| {name}, {one.structure} | {what} | " + " | ".join(cells) + f" | {mixed:.2f} |")
        print(told[-1], flush=True)
    return told


def _silent(done: int, total: int) -> None:
    """Progress that nobody sees."""


def page(objects: list[str]) -> str:
    """The study as a page."""
    lines = [
        "# Hypotheses against long chains",
        "",
        f"`python -m tests.models.inference.posterior_study {' '.join(objects)} --page PAGE.md`,",
        f"seed {SEED}.",
        "",
        "The hypotheses of a belief are randomised refits. Here they are compared with samples of the same",
        f"posterior by Hamiltonian Monte Carlo: {CHAINS} chains of {ITERATIONS} trajectories, the first",
        f"{DROPPED} dropped. Objects slide exactly as the model says, and five pushes chosen as usual teach.",
        "Each object's likeliest structure is looked at, with the prior's usual strength. Means and standard",
        "deviations; mm, N and kg. The last column is the chains' potential scale reduction: 1 where they",
        "agree with one another.",
        "",
        "| object | | truth | hypotheses | chains | agreement |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name in objects:
        lines += rows(name)
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("objects", nargs="+", metavar="OBJECT")
    parser.add_argument("--page", type=Path)
    given = parser.parse_args()
    text = page(given.objects)
    if given.page is not None:
        given.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

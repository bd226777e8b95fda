"""How well a fitted model predicts pushes that were locked away before anything was fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slipmap.models.inference.diagnosis.correlated import CorrelatedLikelihood, FitData
from slipmap.models.inference.diagnosis.fitting import Fitted
from slipmap.models.inference.observations import Observation
from slipmap.models.measurements import PushDataset, pose_times
from slipmap.models.physics.cell_grid import FloatArray
from slipmap.models.physics.paper_notation import add


@dataclass(frozen=True, eq=False)
class LockedErrors:
    """Errors on each of L locked pushes.

    Attributes:
        path: (L,) ADD averaged over the trajectory, m.
        final: (L,) ADD at the end, m.
        misfit: (L,) root mean square of all residuals over the noise of a row, mean forces over stretches
            included.
    """

    path: FloatArray
    final: FloatArray
    misfit: FloatArray

    @property
    def total_misfit(self) -> float:
        """Root mean square over all pushes."""
        return float(np.sqrt((self.misfit**2).mean()))

    @property
    def typical_misfit(self) -> float:
        """Geometric mean over all pushes, which one that starts near to balance does not decide."""
        return float(np.exp(np.log(self.misfit).mean()))


def locked_trials(dataset: PushDataset, rng: np.random.Generator) -> list[str]:
    """Names of the trials to lock away: those held out, else three in ten, one at least where there are
    three."""
    heldout = [trial.name for trial in dataset.heldout_trials]
    if heldout:
        return heldout
    names = [trial.name for trial in dataset.trials]
    if len(names) < 3:
        return []
    count = max(1, round(0.3 * len(names)))
    return sorted(rng.choice(names, count, replace=False).tolist())


def locked_errors(fitted: Fitted, dataset: PushDataset, observations: Sequence[Observation]) -> LockedErrors:
    """Predict locked pushes from their first pose and compare with every row that was measured."""
    prior = fitted.likelihood.prior
    likelihood = CorrelatedLikelihood(prior, FitData(observations, dataset.grid), fitted.likelihood.error)
    trials = {trial.name: trial for trial in dataset.trials}
    pushes = [
        replace(o.push, pose_times=np.minimum(pose_times(trials[o.trial]), (len(o.push.tip) - 1) * o.push.h))
        for o in observations
    ]
    rollouts = prior.slider.rollout(prior.maps(fitted.z[None]), pushes)
    rows = likelihood.rows(fitted.z, np.zeros((len(observations), 3)))
    centers = prior.slider.grid.centers
    noise = fitted.likelihood.error.noise
    path, final, misfit = [], [], []
    for b, o in enumerate(observations):
        measured = trials[o.trial].object_pose.values
        predicted = rollouts.poses_of(b)[0]
        distance = add(predicted, measured, centers)
        path.append(float(distance.mean()))
        final.append(float(add(predicted[-1], o.poses[-1], centers)))
        scaled = (predicted - measured) / np.array([noise.position, noise.position, noise.angle])
        parts = [scaled.ravel()]
        if len(rows[b].force):
            parts.append((rows[b].force / noise.force).ravel())
        misfit.append(float(np.sqrt((np.concatenate(parts) ** 2).mean())))
    return LockedErrors(np.array(path), np.array(final), np.array(misfit))

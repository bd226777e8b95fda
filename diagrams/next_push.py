"""The push that would tell most, carried out on every model that it is to tell apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from models.inference.diagnosis import Diagnosis
from models.measurements import PushDataset
from models.physics.cell_grid import FloatArray
from planners.exploration import CandidatePush


def rival_ends(
    diagnosis: Diagnosis, dataset: PushDataset, push: Mapping[str, object]
) -> list[tuple[str, FloatArray]]:
    """Name and pose (3,) at the end of the push for each rival, or for the model alone where there is none.

    Args:
        diagnosis: whose rivals are asked.
        dataset: whose pushes came before.
        push: the next push of a diagnosis, see `docs/diagnose.md`.
    """
    pose = np.asarray(push["pose"], dtype=float)
    start, end = (np.asarray(push[key], dtype=float) for key in ("tip_start", "tip_end"))
    c, s = np.cos(pose[2]), np.sin(pose[2])
    to_object = np.array([[c, -s], [s, c]])
    way = float(np.hypot(*(end - start)))
    straight = CandidatePush(
        cell=-1,
        contact=np.asarray(push["contact"], dtype=float),
        direction=(end - start) / way @ to_object,
        touch=(start - pose[:2]) @ to_object,
        approach=0.0,
        length=way,
        speed=float(push["speed"]),  # type: ignore[arg-type]
    ).push(pose)
    straight = replace(straight, order=float(len(dataset.trials)))
    ends = []
    for fitted in diagnosis.rivals or (diagnosis.best,):
        prior = fitted.likelihood.prior
        rollouts = prior.slider.rollout(prior.maps(fitted.z[None]), [straight])
        name = " and ".join(effect.name for effect in fitted.effects) or "the model"
        ends.append((name, rollouts.poses_of(0)[0, -1]))
    return ends

"""Push datasets that need no robot: a hammer with known maps, and a block with a hidden effect."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from slipmap.models.inference.belief import Belief
from slipmap.models.measurements.push_dataset import PushDataset
from slipmap.models.measurements.reading import read_dataset
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects.benchmark_objects import HEAD, hammer
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.models.settings import check_whole
from slipmap.planners.exploration import candidate_pushes

FINGER_RADIUS = 0.008


def simulated_hammer(seed: int = 0, *, fit: int = 6, heldout: int = 4) -> tuple[PushDataset, Maps]:
    """Random pushes of the hammer, each from a different pose on the table, and the true maps.

    Args:
        seed: of the pushes and of the sensors' noise.
        fit: pushes to learn from.
        heldout: pushes to judge with.

    Raises:
        ValueError: an argument that is not a whole number of at least 0.

    Example:
        >>> import slipmap
        >>> dataset, truth = slipmap.simulated_hammer(seed=1, fit=3, heldout=1)
        >>> [trial.role for trial in dataset.trials], truth.mass.shape
        (['fit', 'fit', 'fit', 'heldout'], (1, 60))
    """
    for name, count in (("seed", seed), ("fit", fit), ("heldout", heldout)):
        check_whole(name, count, 0)
    grid, truth = hammer()
    slider = Slider(grid, FINGER_RADIUS)
    rng = np.random.default_rng(seed)
    candidates = candidate_pushes(grid, FINGER_RADIUS, rng, fit + heldout)
    poses = rng.uniform([-0.1, -0.1, -np.pi], [0.1, 0.1, np.pi], (len(candidates), 3))
    dataset = record_pushes(
        slider,
        truth,
        [candidate.push(pose) for candidate, pose in zip(candidates, poses, strict=True)],
        rng,
        heldout=heldout,
        name="hammer",
        description="Simulated: a hammer of steel and wood, pushed at random; sensors with noise.",
        height=HEAD[2],
        mass=round(float(truth.mass.sum()), 3),
    )
    return dataset, truth


def tilted_block() -> PushDataset:
    """Twelve pushes of a block of 0.72 kg on a table that is not level, as `slipmap example` writes them.

    They were simulated with a slope of 0.05 rad along x and -0.03 rad along y, and are part of the package.

    Example:
        >>> import slipmap
        >>> dataset = slipmap.tilted_block()
        >>> len(dataset.trials), dataset.mass
        (12, 0.72)
    """
    return read_dataset(Path(__file__).with_name("tilted_block"))


def true_values(belief: Belief, truth: Maps) -> dict[str, float]:
    """True values, SI, by name, of the quantities that an identification reports, for one model's maps."""
    certain = replace(belief, maps=truth, probability=np.ones(1), effects=())
    middle = belief.grid.center_of(truth.mass[0] * truth.mu[0])
    return {
        "total mass": float(truth.mass.sum()),
        "centre of mass, x": float(certain.centers_of_mass[0, 0]),
        "centre of mass, y": float(certain.centers_of_mass[0, 1]),
        "total friction": float(certain.friction_forces[0]),
        "centre of friction, x": float(middle[0]),
        "centre of friction, y": float(middle[1]),
        "finger friction": float(truth.mu_finger[0]),
    }

import numpy as np
import pytest
from pydrake.systems.sensors import ImageDepth32F

from slipmap.diagrams.perception import depth_noise
from slipmap.diagrams.perception.depth_noise import DepthNoise, DepthNoiseConfig, noisy_depth


def step(near=1.0, far=1.1):
    depth = np.full((240, 320), far, np.float32)
    depth[:, 100:200] = near
    return depth


def draw(depth, seed=0, **changes):
    return noisy_depth(depth, DepthNoiseConfig(**changes), np.random.default_rng(seed))


NONE = {
    "axial_floor": 0.0,
    "axial_growth": 0.0,
    "lateral_jitter": 0.0,
    "missing_at_edges": 0.0,
    "missing_anywhere": 0.0,
    "quantum": 0.0,
}


def test_without_noise_nothing_changes():
    depth = step()
    depth[:10] = np.inf
    assert np.array_equal(draw(depth, **NONE), depth)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 1.0, 2.0])
def test_axial_noise_has_the_given_deviation_and_grows_with_depth(correlation):
    changes = NONE | {"axial_floor": 0.5e-3, "axial_growth": 2e-3, "correlation": correlation}
    for depth in (0.5, 2.0):
        noise = draw(np.full((480, 640), depth, np.float32), **changes) - depth
        assert np.std(noise) == pytest.approx(0.5e-3 + 2e-3 * depth**2, rel=0.04)
        assert abs(np.mean(noise)) < 0.05 * np.std(noise)
        within = np.mean(np.abs(noise) < np.std(noise))
        assert within == pytest.approx(0.683, abs=0.01)  # normal


def test_edges_jitter_without_a_bias():
    noisy = draw(step(), **NONE | {"lateral_jitter": 1.5, "correlation": 1.0})
    edge = np.sum(noisy[:, 50:150] > 1.05, axis=1)  # pixels before the edge at column 100
    assert np.std(edge) > 0.5
    assert np.mean(edge) == pytest.approx(50, abs=0.25)
    assert set(np.unique(noisy)) == {np.float32(1.0), np.float32(1.1)}


def test_readings_are_missing_at_edges_most_and_come_in_steps():
    noisy = draw(step(), **NONE | {"missing_at_edges": 0.4, "missing_anywhere": 0.02, "quantum": 4e-3})
    missing = noisy == 0
    assert missing[:, [99, 100, 199, 200]].mean() == pytest.approx(0.4, abs=0.06)
    assert missing[:, 110:190].mean() == pytest.approx(0.02, abs=0.005)
    assert np.unique(noisy[~missing]) == pytest.approx([1.0, 1.1], abs=2.1e-3)
    assert np.allclose(noisy / 4e-3, np.round(noisy / 4e-3), atol=1e-3)


def test_values_out_of_range_are_refused():
    with pytest.raises(ValueError, match="missing_at_edges"):
        DepthNoiseConfig(missing_at_edges=1.5)
    with pytest.raises(ValueError, match="axial_floor"):
        DepthNoiseConfig(axial_floor=-1.0)
    with pytest.raises(ValueError, match="rate"):
        DepthNoise(rate=0.0)


def test_a_frames_noise_depends_on_its_number_alone(world):
    context = world.context()
    port = world.noise.get_output_port()

    def frame(time):
        context.SetTime(time)
        return port.Eval(world.noise.GetMyContextFromRoot(context)).data.copy()

    first, later, again = frame(1 / 15), frame(4 / 15), frame(1 / 15 + 1e-9)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, later)


def test_no_picture_waits_for_the_compiler():
    block = DepthNoise()
    context, picture = block.CreateDefaultContext(), ImageDepth32F(8, 4)
    picture.mutable_data[:] = 1.0
    block.get_input_port().FixValue(context, picture)
    compiled = len(depth_noise._measure.signatures)
    assert block.get_output_port().Eval(context).data.shape == (4, 8, 1)
    assert len(depth_noise._measure.signatures) == compiled

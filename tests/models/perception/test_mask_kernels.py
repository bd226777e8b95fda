import numpy as np

from slipmap.models.perception.object_mask import between


def closed_in(mask, missing, row, column):
    """Whether a missing pixel's run, along its row or its column, ends at the mask on both sides."""
    if not missing[row, column]:
        return False
    for line, gap, at in ((mask[row], missing[row], column), (mask[:, column], missing[:, column], row)):
        before = [k for k in range(at) if not gap[k]]
        after = [k for k in range(at + 1, len(line)) if not gap[k]]
        if before and after and line[before[-1]] and line[after[0]]:
            return True
    return False


def test_runs_that_end_at_the_mask_on_both_sides_are_found():
    rng = np.random.default_rng(3)
    filled = 0
    for _ in range(20):
        missing = rng.random((9, 13)) < 0.6
        mask = (rng.random(missing.shape) < 0.6) & ~missing
        meant = [[closed_in(mask, missing, i, j) for j in range(13)] for i in range(9)]
        np.testing.assert_array_equal(between(mask, missing), meant)
        filled += np.sum(meant)
    assert filled > 50

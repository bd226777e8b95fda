"""Names that options offer, apart from what they name so that help texts load quickly."""

STRATEGIES = ("random", "most-different", "most-distinctive")
"""Of Algorithm 2, in `planners.action_selection`."""

METHODS = ("probabilistic", "deterministic", "uniform", "true")
"""Of planning, in `planners.methods`: all hypotheses; one of them drawn; every cell alike; the truth."""

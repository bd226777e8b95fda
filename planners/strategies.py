"""Names of the strategies of `planners.action_selection`, apart from it so that help texts load quickly."""

STRATEGIES = ("random", "most-different", "most-distinctive")

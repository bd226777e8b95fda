"""The sliding object: one step, rollouts of many steps, and their derivatives.

The order of a step stands in `kernel.py`, for rollouts and for one step alone. Its parts are in `step.py`;
the minimum is found in `newton.py`, with the finger's contact of `contact.py`. `terms.py` is what effects
change, with the friction of `friction.py`. `slopes.py` differentiates a step, `blocks.py` carries the
derivatives along. `rollout.py` (`Slider`) and `stepper.py` (`Stepper`) are the doors from Python; `pushes.py`
and `maps.py` hold what goes in. `balance.py` is about the table's edge.
"""

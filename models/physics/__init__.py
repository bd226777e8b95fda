"""The sliding object: one step, rollouts of many steps, and their derivatives.

A step is solved in `step.py` (`solve_step`), by Newton's method in `newton.py`, with the finger's contact of
`contact.py`. `around_step.py` has what happens before and after it. `kernel.py` makes rollouts of the plain
model, `effect_kernel.py` those with effects, `single_step.py` one step alone, for Drake. `rollout.py`
(`Slider`) is the door from Python; `pushes.py` and `maps.py` hold what goes in. `balance.py` is about the
table's edge.
"""

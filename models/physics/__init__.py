"""The sliding object: one step, rollouts of many steps, and their derivatives.

`kernel.py` holds the sequence of a step, for rollouts and for single steps, and `step.py` its parts.
`newton.py` finds the minimum, with the finger's contact from `contact.py`. `terms.py` holds the terms that
effects change, with the friction of `friction.py`. `slopes.py` differentiates a step, and `blocks.py` carries
the derivatives along. Python code calls `rollout.py` (`Slider`) and `stepper.py` (`Stepper`); `pushes.py` and
`maps.py` hold their inputs. `support.py` and `balance.py` handle the table's edge.
"""

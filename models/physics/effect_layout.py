"""What the formulas of effects are evaluated at and what they fill in: the order of the numbers.

What they are evaluated at, y, joins

    the state before the step: x, y, θ (world), v_x, v_y, omega (object frame);
    memory: nothing, or the last force of the finger on the object (world, N) and the effects' own numbers;
    m, s_x, s_y, J;  and the effects' parameters.

`models.effects.program` writes functions that keep to it, `effect_kernel.py` calls them.
"""

STATE = 6
FORCE = 2
INERTIA = 4

BODY_OUTPUTS = 5
"""Wrench (middle frame: 2 forces, torque about the origin), inertia factor, compliance of the finger (m/N);
each blade adds F, b_x, b_y, b_omega."""

INERTIA_FACTOR = 3
COMPLIANCE = 4

STRETCH = 3
"""Entries of a cell's Q: q_xx, q_xy, q_yy."""

CONSTANTS = 11
"""Time in the middle of the step, h, order of the push in the experiment, gravity, cell width, the cells'
centroid (2), the inverse of their second moments about it (xx, xy, yy; 1/m²), and their number."""

AFTER = 8
"""What memory is renewed from besides y: x, y, θ, v_x, v_y, omega after the step and the force in it."""
